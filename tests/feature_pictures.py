"""Pictures of a printed board in front of a cluttered wall, drawn by homographies: exact, and without a renderer."""

from __future__ import annotations

import cv2
import numpy as np

from aerograsp_env.interfaces import Intrinsics

CAMERA = Intrinsics(320, 240, 330.0, 330.0, 159.5, 119.5)
WIDTH, HEIGHT = 0.24, 0.18  # [m] of the board, its middle at the origin, in the plane z = 0
PIXELS = (480, 360)


def poster(seed: int) -> np.ndarray:
    """A print (360, 480, 3)."""
    rng = np.random.default_rng(seed)
    image = np.full((PIXELS[1], PIXELS[0], 3), rng.integers(130, 250, 3), dtype=np.uint8)
    for _ in range(40):
        a, b = rng.integers(0, PIXELS[0], 2), rng.integers(10, 90, 2)
        color = tuple(int(c) for c in rng.integers(0, 255, 3))
        cv2.rectangle(image, tuple(map(int, a)), tuple(map(int, a + b)), color, -1)
        word = "".join(rng.choice(list("ABCDEFGHKLMNPRSTUVXYZ2345689"), 5))
        at = (int(rng.integers(0, PIXELS[0])), int(rng.integers(0, PIXELS[1])))
        cv2.putText(image, word, at, cv2.FONT_HERSHEY_SIMPLEX, 0.9, color[::-1], 2, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), 1.2)


def homography(T_c_board: np.ndarray) -> np.ndarray:
    """(3, 3) from the print's pixels to the camera's."""
    to_board = np.array(
        [[WIDTH / PIXELS[0], 0.0, -0.5 * WIDTH], [0.0, HEIGHT / PIXELS[1], -0.5 * HEIGHT], [0.0, 0.0, 1.0]]
    )
    return CAMERA.matrix @ T_c_board[:3, [0, 1, 3]] @ to_board


def board_points(T_c_board: np.ndarray) -> np.ndarray:
    """(H, W) 255 where the board is seen."""
    full = np.full((PIXELS[1], PIXELS[0]), 255, dtype=np.uint8)
    return cv2.warpPerspective(full, homography(T_c_board), (CAMERA.width, CAMERA.height))


def draw_board(image: np.ndarray, T_c_board: np.ndarray, wall: int) -> np.ndarray:
    """(240, 320, 3) the board before a wall of other prints that is at infinity."""
    behind = cv2.resize(poster(1000 + wall), (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
    seen = cv2.warpPerspective(image, homography(T_c_board), (CAMERA.width, CAMERA.height), flags=cv2.INTER_AREA)
    return np.where(board_points(T_c_board)[..., None] > 127, seen, behind)


def hide_half(picture: np.ndarray, T_c_board: np.ndarray, angle: float, wall: int) -> np.ndarray:
    """The picture with another print over that half of the board's pixels which lies towards `angle`."""
    rows, columns = np.nonzero(board_points(T_c_board) > 127)
    normal = np.array([np.cos(angle), np.sin(angle)])
    edge = np.median(np.column_stack([columns, rows]) @ normal)
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width]
    cover = cv2.resize(poster(2000 + wall), (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
    return np.where((x * normal[0] + y * normal[1] > edge)[..., None], cover, picture)
