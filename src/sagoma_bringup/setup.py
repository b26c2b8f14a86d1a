from glob import glob

from setuptools import find_packages, setup

package_name = "sagoma_bringup"
share = f"share/{package_name}"
# config is a link to the repository's config folder
CONFIG_FOLDERS = ("rig", "camera", "camera/footage", "body", "dds", "rviz", "foxglove", "diagnostics")

setup(
    name=package_name,
    version="0.1.0",
    description="The node graph as data, launch files, rviz configuration.",
    license="Apache-2.0",
    maintainer="sagoma maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-689beada.example",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (share, ["package.xml"]),
        (f"{share}/launch", glob("launch/*.launch.*")),
        *((f"{share}/config/{folder}", glob(f"config/{folder}/*.*")) for folder in CONFIG_FOLDERS),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
)
