"""Boards as text, as files and on paper."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from capture_rig.errors import InputError
from rig_calibration.boards.board import CharucoBoard, Checkerboard, board_text, opencv_board, read_board
from rig_calibration.boards.drawing import draw_board, save_for_print


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("checkerboard 9x6 25mm", Checkerboard(9, 6, (0.025, 0.025))),
        ("Chessboard 9 x 6 2.5 cm", Checkerboard(9, 6, (0.025, 0.025))),
        ("checkerboard 4x3 297x210mm", Checkerboard(4, 3, (0.297, 0.21))),
        ("checkerboard 9x6 1in", Checkerboard(9, 6, (0.0254, 0.0254))),
        ("charuco 11x8 30mm 22mm DICT_5X5_100", CharucoBoard(11, 8, 0.03, 0.022, "DICT_5X5_100")),
        ("charuco 6x4 3cm 22mm dict_4x4_50 legacy", CharucoBoard(6, 4, 0.03, 0.022, "DICT_4X4_50", True)),
    ],
)
def test_text_describes_board_and_is_read_back(text, board):
    assert read_board(text) == board
    assert read_board(board_text(board)) == board


def test_yaml_file_and_text_give_the_same_board(tmp_path):
    file = tmp_path / "board.yaml"
    file.write_text("type: checkerboard\ncolumns: 4\nrows: 3\nfield_m: [0.297, 0.21]\n")
    assert read_board(str(file)) == read_board("checkerboard 4x3 297x210mm")
    file.write_text("type: charuco\ncolumns: 5\nrows: 4\nsquare_m: 0.03\nmarker_m: 0.02\ndictionary: DICT_4X4_50\n")
    assert read_board(str(file)) == read_board("charuco 5x4 30mm 20mm DICT_4X4_50")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("checkerboard 9x6 25", "describes no board"),
        ("checkerboard 9x6", "describes no board"),
        ("checkerboard 2x6 25mm", "columns = 2"),
        ("checkerboard 4x4 25mm", "looks the same from all four sides"),
        ("checkerboard 9x6 25m", "field_m = 25"),
        ("charuco 11x8 22mm 30mm DICT_5X5_100", "not smaller"),
        ("charuco 11x8 30mm 22mm DICT_9X9_100", "DICT_9X9_100"),
        ("charuco 20x20 30mm 22mm DICT_4X4_50", "200 markers"),
        ("missing.yaml", "cannot be read"),
        ("type: dots\n", "type = 'dots'"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\n", "'field_m' is missing"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\nfield_m: 25\n", "field_m = 25"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\nfield_m: [1, 2, 3]\n", "field_m = "),
        ("type: checkerboard\ncolumns: 9.5\nrows: 6\nfield_m: 0.025\n", "columns = 9.5"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\nfield_m: 0.025\ncolor: red\n", "'color' is not known"),
    ],
)
def test_unusable_text_or_file_is_refused_with_what_is_wrong_and_a_remedy(tmp_path, text, says):
    where = text
    if text.startswith("type"):
        where = str(tmp_path / "board.yaml")
        Path(where).write_text(text)
    with pytest.raises(InputError, match=says) as refusal:
        read_board(where)
    assert refusal.value.remedy and where in str(refusal.value)


# --- on paper ---------------------------------------------------------------------------------------------------------

CHECKERBOARD = read_board("checkerboard 9x6 25mm")
CHARUCO = read_board("charuco 5x7 30mm 21mm DICT_5X5_100")


MM_PER_PT = 25.4 / 72


def read_svg(file):
    """Width and height of the page, and what is black on it (left, top, width, height), all in mm."""
    root = ElementTree.parse(file).getroot()
    size = [float(root.get(key).removesuffix("pt")) * MM_PER_PT for key in ("width", "height")]
    paths = [node.get("d", "") for node in root.iter("{http://www.w3.org/2000/svg}path")]
    (black,) = [path for path in paths if path.count("M") > 10]  # not the page, not the letters
    outlines = re.findall(r"M ([^z]+)z", black)
    corners = [np.array(re.findall(r"-?[\d.]+", outline), float).reshape(-1, 2) * MM_PER_PT for outline in outlines]
    return np.array(size), np.array([[*one.min(0), *np.ptp(one, axis=0)] for one in corners])


def test_print_is_true_to_scale_and_its_ruler_is_100_mm_long(tmp_path):
    (file,) = save_for_print(CHECKERBOARD, tmp_path / "board.svg")
    size, black = read_svg(file)
    np.testing.assert_allclose(size, [297, 210], atol=1e-5)
    fields = black[np.all(np.abs(black[:, 2:] - 25) < 1e-3, axis=1)]
    assert len(fields) == 35
    low, high = fields[:, :2].min(0), (fields[:, :2] + fields[:, 2:]).max(0)
    np.testing.assert_allclose(high - low, [250, 175], atol=1e-3)
    assert np.any(np.abs(black[:, 2] - 100) < 1e-5)


def test_board_larger_than_the_paper_is_laid_over_pages_without_losing_any_black(tmp_path):
    board = read_board("checkerboard 5x4 85mm")
    files = save_for_print(board, tmp_path / "floor.svg")
    assert len(files) > 1
    area = 0.0
    for file in files:
        size, black = read_svg(file)
        inside = black[(black[:, 2] > 1) & (black[:, 3] > 1)]
        area += np.sum(inside[:, 2] * inside[:, 3])
        assert np.all(inside[:, :2] >= 10 - 1e-5)
        assert np.all(inside[:, :2] + inside[:, 2:] <= size - 10 + 1e-5)
    assert area == pytest.approx(15 * 85 * 85, rel=1e-6)
    assert len(save_for_print(board, tmp_path / "floor_a1.svg", "A1")) == 1


def test_pdf_has_the_paper_s_size(tmp_path):
    (file,) = save_for_print(CHECKERBOARD, tmp_path / "board.pdf")
    found = re.search(rb"MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", file.read_bytes())
    box = [float(number) for number in found.groups()]
    np.testing.assert_allclose(np.array(box) / 72 * 25.4, [297, 210], atol=1e-3)


def test_same_board_gives_the_same_bytes(tmp_path):
    for suffix in (".svg", ".pdf"):
        first, second = (save_for_print(CHARUCO, tmp_path / f"{name}{suffix}")[0] for name in "ab")
        assert first.read_bytes() == second.read_bytes()


def test_unknown_suffix_and_paper_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"neither \.svg nor"):
        save_for_print(CHECKERBOARD, tmp_path / "board.docx")
    with pytest.raises(InputError, match="A9"):
        save_for_print(CHECKERBOARD, tmp_path / "board.svg", "A9")


@pytest.mark.parametrize("text", ["charuco 5x7 30mm 21mm DICT_5X5_100", "charuco 6x4 30mm 18mm DICT_4X4_50 legacy"])
def test_charuco_is_drawn_as_opencv_draws_it(text):
    board = read_board(text)
    cells = 6 if "4X4" in text else 7
    per_field = round(30 * cells / (21 if cells == 7 else 18)) * 4
    ours = draw_board(board, per_field / board.square_m, margin_m=0.0).image
    theirs = opencv_board(board).generateImage((board.columns * per_field, board.rows * per_field), marginSize=0)
    assert ours.shape == theirs.shape
    assert np.mean((ours > 127) != (theirs > 127)) < 0.01


@pytest.mark.parametrize(
    ("name", "paper"), [("checkerboard_a4", "A4"), ("charuco_a4", "A4"), ("floor_a3", "A3"), ("floor_a2", "A2")]
)
def test_boards_that_come_along_fit_on_one_page_of_the_paper_they_are_named_for(tmp_path, name, paper):
    board = read_board(str(Path(__file__).parents[3] / "config/board" / f"{name}.yaml"))
    assert len(save_for_print(board, tmp_path / "board.pdf", paper)) == 1
    assert (tmp_path / "board.pdf").read_bytes().count(b"/MediaBox") == 1
    assert board.half_turn_is_visible
