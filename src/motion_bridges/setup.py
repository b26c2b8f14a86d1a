from setuptools import find_packages, setup

package_name = "motion_bridges"

setup(
    name=package_name,
    version="0.1.0",
    description="Live motion for other programs: VMC (OSC), Lab Streaming Layer, joint angles of the ISB.",
    license="Apache-2.0",
    maintainer="sagoma maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-689beada.example",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "lsl": ["pylsl>=1.18"]},
    zip_safe=True,
    entry_points={
        "console_scripts": [
            "isb_angles = motion_bridges.isb_node:main",
            "lsl_bridge = motion_bridges.lsl_node:main",
            "vmc_bridge = motion_bridges.vmc_node:main",
        ]
    },
)
