"""Settings as parameters of a real node, what is refused with its reason, and the names that nodes resolve."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from capture_rig.errors import InputError
from capture_rig.settings import setting
from sagoma_ros.middleware import package_path
from sagoma_ros.node import declare_parameters, read_parameters
from sagoma_ros.qos import graph_topic

if TYPE_CHECKING:
    from node_probe import Spinner

RIG = Path(__file__).resolve().parents[3] / "config" / "rig" / "ring4.yaml"


@dataclass(frozen=True)
class Blob:
    min_area_m2: float = setting(0.002, "smallest blob", unit="m^2", low=0, high=1)


@dataclass(frozen=True)
class Settings:
    rig_file: str = setting("", "the rig")
    backend: str = setting("auto", "what carves", choices=("auto", "cpu", "gl"))
    cameras: int = setting(4, "how many", low=1, high=64)
    loop: bool = setting(False, "start again at the end")
    voxel_m: float = setting(0.02, "voxel size", unit="m", low=0.002, high=0.2)
    axes: list[str] = setting(["x", "y"], "slicing directions")
    low: list[float] = setting([0.0, 0.0], "corner", unit="m")
    ids: list[int] = setting([], "numbers")
    blob: Blob = field(default_factory=Blob)


def make_node(ros: Spinner, overrides: dict[str, Any] | None = None, arguments: list[str] | None = None) -> Node:
    given = [Parameter(key, value=value) for key, value in (overrides or {}).items()]
    options = {"namespace": "studio", "context": ros.context, "cli_args": arguments}
    node = Node("hull_server", parameter_overrides=given, **options)
    declare_parameters(node, Settings)
    return ros.add(node)


def test_overrides_are_read_typed_and_what_was_not_given_is_the_default(ros: Spinner) -> None:
    assert read_parameters(make_node(ros), Settings) == Settings()
    lists = {"axes": ["z"], "low": [-1.5, 2.0], "ids": [3, 1]}
    given = {"rig_file": "rig.yaml", "cameras": 6, "loop": True, "voxel_m": 0.01, "blob.min_area_m2": 0.5} | lists
    settings = read_parameters(make_node(ros, given), Settings)
    assert settings == Settings("rig.yaml", "auto", 6, True, 0.01, ["z"], [-1.5, 2.0], [3, 1], Blob(0.5))


def test_parameter_file_is_read_with_empty_lists(ros: Spinner, tmp_path: Path) -> None:
    (tmp_path / "params.yaml").write_text(
        "/studio/hull_server:\n  ros__parameters:\n    cameras: 5\n    low: [0.5, 1.0]\n    ids: [4, 2]\n"
        "    axes: []\n    use_sim_time: false\n    blob: {min_area_m2: 0.25}\n"
    )
    arguments = ["--ros-args", "--params-file", str(tmp_path / "params.yaml")]
    read = read_parameters(make_node(ros, arguments=arguments), Settings)
    assert (read.cameras, read.low, read.ids, read.axes, read.blob) == (5, [0.5, 1.0], [4, 2], [], Blob(0.25))


def test_later_change_that_is_bad_is_rejected_with_its_reason_and_one_that_is_good_is_read_next_time(
    ros: Spinner,
) -> None:
    node = make_node(ros, {"cameras": 0})  # making the node succeeds, so that it can say what is wrong
    with pytest.raises(InputError, match=r"^parameters of /studio/hull_server: .*cameras = 0 is out of range"):
        read_parameters(node, Settings)
    (result,) = node.set_parameters([Parameter("low", value=[0.0, float("inf")])])
    assert not result.successful and "low = [0.0, inf]" in result.reason
    results = node.set_parameters([Parameter("cameras", value=8), Parameter("low", value=[1.0, 2.0])])
    assert all(result.successful for result in results)
    read = read_parameters(node, Settings)
    assert (read.cameras, read.low) == (8, [1.0, 2.0])


def test_parameters_are_described_with_unit_and_with_ranges_for_sliders(ros: Spinner) -> None:
    described = make_node(ros).describe_parameters(["voxel_m", "backend", "cameras", "low"])
    voxel, backend, cameras, low = described
    assert (voxel.description, voxel.additional_constraints) == ("voxel size [m]", "0.002 to 0.2")
    assert backend.additional_constraints == "one of auto, cpu, gl"
    assert [(r.from_value, r.to_value) for r in voxel.floating_point_range] == [(0.002, 0.2)]
    assert [(r.from_value, r.to_value, r.step) for r in cameras.integer_range] == [(1, 64, 1)]
    assert not (voxel.dynamic_typing or low.floating_point_range or voxel.integer_range)


def test_whole_numbers_given_for_decimals_keep_the_parameters_type(ros: Spinner) -> None:
    node = make_node(ros, {"blob.min_area_m2": 1, "low": [1, 2]})
    assert read_parameters(node, Settings).blob.min_area_m2 == 1.0
    double = Parameter.Type.DOUBLE
    assert node.get_parameter("blob.min_area_m2").type_ == double
    assert node.get_parameter("low").type_ == Parameter.Type.DOUBLE_ARRAY
    assert node.set_parameters_atomically([Parameter("blob.min_area_m2", value=0)]).successful
    assert (node.get_parameter("blob.min_area_m2").type_, node.get_parameter("blob.min_area_m2").value) == (double, 0.0)
    refused = node.set_parameters_atomically([Parameter("cameras", value=4.0)])
    assert not refused.successful and "cameras = 4.0 is not of type int" in refused.reason


# --- names


@pytest.mark.parametrize(
    ("namespace", "expected"),
    [("", "/hull/thinning"), ("/cam01", "/hull/thinning"), ("/lab/cam01", "/lab/hull/thinning")],
)
def test_a_topic_of_the_graph_stands_beside_the_cameras_namespace(ros: Spinner, namespace: str, expected: str) -> None:
    node = ros.add(Node("client", namespace=namespace, context=ros.context))
    assert graph_topic(node, "hull/thinning") == expected
    assert graph_topic(node, "/elsewhere/prediction") == "/elsewhere/prediction"


def test_a_package_uri_is_a_file_in_its_share_folder_or_its_sources(tmp_path: Path, monkeypatch) -> None:
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
def test_a_package_that_is_not_there_is_an_error_that_names_it(uri: str) -> None:
    with pytest.raises(InputError, match=r"there is no package"):
        package_path(uri)
