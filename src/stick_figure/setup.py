from setuptools import find_packages, setup

package_name = "stick_figure"

setup(
    name=package_name,
    version="0.1.0",
    description="The articulated stick figure: body, pose, forward and inverse kinematics, Jacobians, error metrics.",
    license="Apache-2.0",
    maintainer="sagoma maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-689beada.example",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["builds.csv", "joint_centres.csv"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
)
