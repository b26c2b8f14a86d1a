import pytest

from capture_rig.errors import InputError
from rig_calibration.boards.board import CharucoBoard, Checkerboard, board_text, read_board


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
    ],
)
def test_unusable_text_is_refused_with_what_is_wrong(text, says):
    with pytest.raises(InputError, match=says) as refusal:
        read_board(text)
    assert refusal.value.remedy


@pytest.mark.parametrize(
    ("yaml", "says"),
    [
        ("type: dots\n", "type = 'dots'"),
        ("type: checkerboard\ncolumns: 9\n", "'rows' is missing"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\n", "'field_m' is missing"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\nfield_m: 25\n", "field_m = 25"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\nfield_m: [1, 2, 3]\n", "neither a side"),
        ("type: checkerboard\ncolumns: 9.5\nrows: 6\nfield_m: 0.025\n", "columns = 9.5"),
        ("type: checkerboard\ncolumns: 9\nrows: 6\nfield_m: 0.025\ncolor: red\n", "'color' is not known"),
    ],
)
def test_unusable_file_is_refused_with_file_and_key(tmp_path, yaml, says):
    file = tmp_path / "board.yaml"
    file.write_text(yaml)
    with pytest.raises(InputError, match=says) as refusal:
        read_board(str(file))
    assert str(file) in str(refusal.value)


@pytest.mark.parametrize(("columns", "rows", "visible"), [(9, 6, True), (9, 7, False), (8, 6, False), (5, 4, True)])
def test_half_turn_is_visible_where_the_opposite_outer_fields_differ(columns, rows, visible):
    colour_first, colour_last = 0 % 2, (columns + rows) % 2  # of the outer fields at (0, 0) and (rows, columns)
    assert (colour_first != colour_last) == visible
    assert Checkerboard(columns, rows, (0.02, 0.02)).half_turn_is_visible == visible
