"""camera_info files as camera_calibration writes them."""

import textwrap
from dataclasses import replace

import numpy as np
import pytest

from capture_rig.camera import CameraModel
from capture_rig.camera_info_file import load_camera_info, read_camera_info, save_camera_info
from capture_rig.errors import InputError

# written by hand after the calibrator's own output
CALIBRATOR_YAML = textwrap.dedent("""
    image_width: 640
    image_height: 480
    camera_name: cam01
    camera_matrix:
      rows: 3
      cols: 3
      data: [ 438.78356,    0.     ,  305.59331,
                0.     ,  437.30276,  243.73802,
                0.     ,    0.     ,    1.     ]
    distortion_model: plumb_bob
    distortion_coefficients:
      rows: 1
      cols: 5
      data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
    rectification_matrix:
      rows: 3
      cols: 3
      data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
    projection_matrix:
      rows: 3
      cols: 4
      data: [ 393.65381,    0.     ,  309.20056,    0.     ,
                0.     ,  393.86905,  242.50379,    0.     ,
                0.     ,    0.     ,    1.     ,    0.     ]
""")


@pytest.fixture
def camera():
    T = np.eye(4)
    T[:3, 3] = [0.1, 0.2, 3.0]
    K = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])
    return CameraModel("cam01", 640, 480, K, "plumb_bob", np.zeros(5), T)


@pytest.fixture
def file(tmp_path):
    def write(*changes):
        text = CALIBRATOR_YAML
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "cam01.yaml").write_text(text)
        return tmp_path / "cam01.yaml"

    return write


def test_intrinsics_of_the_file_replace_those_of_the_rig_and_the_pose_stays(camera, file):
    read = load_camera_info(file(), camera)
    assert read.K.tolist() == [[438.78356, 0, 305.59331], [0, 437.30276, 243.73802], [0, 0, 1]]
    assert read.D.tolist() == [-0.361976, 0.110510, 0.001014, 0.000505, 0.0]
    assert np.array_equal(read.T_camera_world, camera.T_camera_world) and read.name == "cam01"


@pytest.mark.parametrize(
    "model, D",
    [
        ("plumb_bob", np.array([-0.2, 0.1, 1e-3, -2e-3, 0.03])),
        ("rational_polynomial", np.linspace(-0.1, 0.1, 8)),
        ("equidistant", np.array([-0.02, 0.01, -0.004, 0.0006])),
    ],
)
def test_saved_file_reads_back_the_same_numbers(camera, tmp_path, model, D):
    K = np.array([[500.1, 0, 0.1 + 0.2], [0, 1 / 3 * 1000, 240], [0, 0, 1]])
    calibrated = replace(camera, K=K, distortion_model=model, D=D)
    save_camera_info(tmp_path / "out.yaml", calibrated)
    read = load_camera_info(tmp_path / "out.yaml", camera)
    assert np.array_equal(read.K, K) and np.array_equal(read.D, D) and read.distortion_model == model
    assert [path.name for path in tmp_path.iterdir()] == ["out.yaml"]
    assert (tmp_path / "out.yaml").stat().st_mode & 0o777 == 0o644


def test_pinhole_without_coefficients_has_no_distortion(camera, file):
    path = file(
        ("cols: 5\n  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]", "cols: 0\n  data: []"),
        ("distortion_model: plumb_bob", "distortion_model: ''"),
    )
    read = load_camera_info(path, camera)
    assert read.distortion_model == "plumb_bob" and not read.D.any()


@pytest.mark.parametrize(
    "change, text",
    [
        (("camera_name: cam01", "camera_name: narrow"), "camera_name = 'narrow' is not this camera, 'cam01'"),
        (("image_width: 640", "image_width: 1280"), "is for images of 1280 x 480 pixels, those of cam01 have 640"),
        (("distortion_model: plumb_bob\n", ""), "key 'distortion_model' is missing"),
        (("plumb_bob", "omni"), "distortion_model = 'omni' is not known"),
        (("438.78356,    0. ", "438.78356,    2. "), "is not an intrinsic matrix"),
        (("  cols: 5", "  cols: 4"), "distortion_coefficients"),
        (("data: [1., 0.,", "data: [0.9, 0.,"), "rectification_matrix is not the identity"),
        (("309.20056,    0.     ,", "309.20056,"), "projection_matrix"),
        (("-0.361976", "wide"), "distortion"),
        (("image_width: 640", "image_width: [640"), "is not valid YAML"),
        (("image_width: 640", "image_width: wide"), "image_width = 'wide' is not a whole number from 1"),
        (("camera_name: cam01", "camera_name: 7"), "camera_name = 7 is not a name"),
    ],
)
def test_unusable_file_is_refused_naming_it_and_the_key(camera, file, change, text):
    with pytest.raises(InputError) as refused:
        load_camera_info(file(change), camera)
    assert text in str(refused.value) and "cam01.yaml" in str(refused.value)


def test_camera_read_from_a_file_alone_has_its_name_and_size_and_no_pose(file):
    read = read_camera_info(file())
    assert (read.name, read.width, read.height) == ("cam01", 640, 480)
    assert read.K[0].tolist() == [438.78356, 0, 305.59331] and read.D[0] == -0.361976
    assert np.array_equal(read.T_camera_world, np.eye(4))
