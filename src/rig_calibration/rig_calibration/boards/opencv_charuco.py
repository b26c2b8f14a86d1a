"""The same ChArUco board as OpenCV knows it."""

from __future__ import annotations

import cv2

from .board import CharucoBoard


def opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    """OpenCV's board, whose corner ids are ours."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    theirs = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_m, board.marker_m, dictionary)
    theirs.setLegacyPattern(board.legacy)
    return theirs
