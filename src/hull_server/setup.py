from setuptools import find_packages, setup

package_name = "hull_server"

setup(
    name=package_name,
    version="0.1.0",
    description="Hull server: frame sets of silhouettes in, visual hull, slices and centerline points out.",
    license="Apache-2.0",
    maintainer="sagoma maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-689beada.example",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    entry_points={"console_scripts": ["hull_server = hull_server.hull_node:main"]},
)
