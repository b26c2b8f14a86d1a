"""Names that nodes resolve: topics of the graph above a camera's namespace, files of packages."""

from pathlib import Path

import pytest
from rclpy.node import Node

from capture_rig.errors import InputError
from sagoma_ros.names import graph_topic, package_path, resolve_packages

RIG = Path(__file__).resolve().parents[3] / "config" / "rig" / "ring4.yaml"


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [("", "/hull/thinning"), ("/cam01", "/hull/thinning"), ("/lab/cam01", "/lab/hull/thinning")],
)
def test_a_topic_of_the_graph_stands_beside_the_cameras_namespace(ros, namespace, expected):
    node = ros.add(Node("client", namespace=namespace, context=ros.context))
    assert graph_topic(node, "hull/thinning") == expected
    assert graph_topic(node, "/elsewhere/prediction") == "/elsewhere/prediction"


def test_a_package_uri_is_a_file_in_its_share_folder_or_its_sources(tmp_path, monkeypatch):
    uri = "package://sagoma_bringup/config/rig/ring4.yaml"
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    assert package_path(uri).samefile(RIG)
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "sagoma_bringup").touch()
    (tmp_path / "share" / "sagoma_bringup").mkdir()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert package_path(uri) == tmp_path / "share" / "sagoma_bringup" / "config" / "rig" / "ring4.yaml"


@pytest.mark.parametrize("uri", ["package://no_such_package/rig.yaml", "package://", "package://no such/rig.yaml"])
def test_a_package_that_is_not_there_is_an_error_that_names_it(uri):
    with pytest.raises(InputError, match=r"there is no package"):
        package_path(uri)


def test_other_values_stay_as_they_are():
    values = [1, 0.5, True, "config/rig.yaml", ["a", "b"], []]
    assert [resolve_packages(value) for value in values] == values
