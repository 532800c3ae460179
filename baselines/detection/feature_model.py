"""An object as points that can be recognised in a picture, and its pose from those that are."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import as_array, check_transform, transform_points
from baselines.detection.extraction import FeatureKind, check_image, extract, feature_kind
from baselines.detection.pnp import PnPResult, pinhole, solve_pnp, undistorted
from baselines.detection.projection import project
from baselines.detection.stereo_features import check_size

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

VERSION = 1  # of the file
FEATURES = 2500  # of a picture
LOOSE = 0.92  # ratio of distances that is tried next
SEARCH = 40.0  # [px] around where the guess puts a point


class FeaturePose(NamedTuple):
    """Where a model is in a picture, or why it was not found."""

    T_c_object: Array | None  # (4, 4)
    inliers: int  # matches that agree with the pose
    matches: int  # features of the picture that resemble one point more than any other
    points: Ints  # (I,) rows of the model's points that agree
    pixels: Array  # (I, 2) [px] where they are in the picture
    rmse: float  # [px] reprojection error of the inliers; NaN without a pose
    covariance: Array | None  # (6, 6) camera-frame position [m²], then rotation vector [rad²]
    reason: str  # why there is no pose; empty with one


@dataclass(frozen=True, eq=False)
class FeatureModel:
    """Points of an object with descriptors; a point may have several, from different sides.

    `FeatureModel.load` and `save` keep it in one file of arrays, without pickle; `learn_feature_model` makes one from
    a sequence of a stereo or RGB-D camera.

    Raises:
        ValueError: shapes that do not match, values that are not finite, or descriptors that are not the feature's.
    """

    points: Array  # (N, 3) [m] in the object's frame
    descriptors: NDArray  # (M, D), rows of the same point together
    feature: str  # "detector+descriptor", see `extraction.feature_kind`
    owners: Ints | None = None  # (M,) the point of each descriptor, ascending; None: one for each point, in order
    name: str = "object"

    def __post_init__(self) -> None:
        kind = feature_kind(self.feature)
        points, descriptors = as_array(self.points, (3,), "points"), np.asarray(self.descriptors)
        if points.ndim != 2 or not len(points):
            raise ValueError(f"points: expected shape (N, 3) with N ≥ 1, got {points.shape}")
        if descriptors.ndim != 2 or descriptors.shape[1] != kind.width or descriptors.dtype != kind.dtype:
            raise ValueError(
                f"descriptors: expected (M, {kind.width}) {np.dtype(kind.dtype).name} for {kind}, "
                f"got {descriptors.shape} {descriptors.dtype}"
            )
        if kind.dtype is np.float32 and not np.isfinite(descriptors).all():
            raise ValueError("descriptors: expected finite values")
        owners = np.arange(len(points)) if self.owners is None else np.asarray(self.owners, dtype=np.int64)
        if owners.shape != (len(descriptors),):
            raise ValueError(
                f"owners: expected one point for each of {len(descriptors)} descriptors, got {owners.shape}"
            )
        if len(owners) and (owners[0] < 0 or owners[-1] >= len(points) or (np.diff(owners) < 0).any()):
            raise ValueError(f"owners: expected ascending rows of {len(points)} points")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "descriptors", np.ascontiguousarray(descriptors))
        object.__setattr__(self, "owners", owners)
        object.__setattr__(self, "feature", str(kind))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def kind(self) -> FeatureKind:
        """Detector and descriptor."""
        return feature_kind(self.feature)

    def save(self, path: str | Path) -> None:
        """Write the model as one compressed .npz file."""
        assert self.owners is not None
        with Path(path).open("wb") as file:
            np.savez_compressed(
                file, version=VERSION, points=self.points, descriptors=self.descriptors, owners=self.owners,
                feature=self.feature, name=self.name,
            )  # fmt: skip

    @classmethod
    def load(cls, path: str | Path) -> FeatureModel:
        """Read what `save` wrote; nothing in the file is executed.

        Raises:
            FileNotFoundError: no such file.
            ValueError: a file that is not a feature model, naming it.
        """
        try:
            with np.load(path, allow_pickle=False) as data:
                if int(data["version"]) != VERSION:
                    raise ValueError(f"expected version {VERSION}, got {int(data['version'])}")
                return cls(data["points"], data["descriptors"], str(data["feature"]), data["owners"], str(data["name"]))
        except FileNotFoundError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError, EOFError, OSError, zipfile.BadZipFile) as fault:
            message = " ".join(str(fault).split())
            raise ValueError(f"{path}: expected a feature model written by FeatureModel.save: {message}") from None

    @classmethod
    def read_opencv(cls, path: str | Path, feature: str, name: str = "object") -> FeatureModel:
        """Read a model that OpenCV's FileStorage wrote, XML, YAML or JSON: lists `points` and a matrix `descriptors`.

        Args:
            feature: what the descriptors are; the file does not say.

        Raises:
            FileNotFoundError: no such file.
            ValueError: a file of other content, naming it.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(f"{path}: no such file")
        try:
            storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
            node, matrix = storage.getNode("points"), storage.getNode("descriptors").mat()
            values = [node.at(i).real() for i in range(node.size())] if node.isSeq() else np.ravel(node.mat())
            points = np.array(values, dtype=np.float64).reshape(-1, 3)
        except (cv2.error, SystemError, ValueError, TypeError) as fault:
            raise ValueError(f"{path}: expected OpenCV's storage of points and descriptors: {_line(fault)}") from None
        if matrix is None or not len(points) or len(matrix) != len(points):
            count = 0 if matrix is None else len(matrix)
            raise ValueError(f"{path}: expected a descriptor for each point, got {len(points)} and {count}")
        try:
            return cls(points, matrix, feature, name=name)
        except ValueError as fault:
            raise ValueError(f"{path}: {fault}") from None

    def match(self, descriptors: ArrayLike, ratio: float = 0.8) -> tuple[Ints, Ints]:
        """Rows of given descriptors (F, D) and of the points that they resemble, each point once.

        The nearest descriptor must be closer than `ratio` times the nearest of any *other* point (Lowe 2004, section
        7.1, which asks the same of other objects).
        """
        given = np.asarray(descriptors)
        if given.ndim != 2 or given.shape[1] != self.kind.width or given.dtype != self.kind.dtype:
            raise ValueError(
                f"descriptors: expected (F, {self.kind.width}) {np.dtype(self.kind.dtype).name} for {self.feature}, "
                f"got {given.shape} {given.dtype}"
            )
        if not 0.0 < ratio <= 1.0:
            raise ValueError(f"ratio: expected a number in (0, 1], got {ratio}")
        return _pair(self._distances(given), ratio)

    def _distances(self, given: NDArray) -> NDArray[np.float32]:
        """(F, N) from each given descriptor to each point's nearest; infinite for a point without any."""
        assert self.owners is not None
        nearest = np.full((len(given), len(self)), np.inf, dtype=np.float32)
        if not len(given) or not len(self.descriptors):
            return nearest
        if self.kind.dtype is np.float32:
            lengths = (given**2).sum(axis=1)[:, None] + (self.descriptors**2).sum(axis=1)
            distances = np.sqrt(np.maximum(lengths - 2.0 * given @ self.descriptors.T, 0.0))
        else:
            ours, theirs = (np.ascontiguousarray(x).view(np.uint64) for x in (self.descriptors, given))
            counts = np.zeros((len(given), len(ours)), dtype=np.uint16)
            for k in range(ours.shape[1]):
                counts += np.bitwise_count(theirs[:, k, None] ^ ours[:, k])
            distances = counts.astype(np.float32)
        names, starts = np.unique(self.owners, return_index=True)
        nearest[:, names] = np.minimum.reduceat(distances, starts, axis=1)
        return nearest

    def locate(
        self,
        image: ArrayLike,
        intrinsics: Intrinsics,
        mask: ArrayLike | None = None,
        T_guess: ArrayLike | None = None,
        n: int = FEATURES,
        ratio: float = 0.8,
        threshold: float = 3.0,
        min_inliers: int = 6,
        confidence: float = 0.999,
    ) -> FeaturePose:
        """Find the object in a picture: features, matches, then the pose from those that agree.

        Args:
            image: (H, W) or (H, W, 3) RGB, uint8.
            mask: (H, W) bool: where to look; None is everywhere.
            T_guess: (4, 4) about where it should be, such as where it was in the last picture: tried as well, and where
                the whole picture gives no pose, features are also sought near to where it puts the points.
            n: features of the picture at most.
            ratio: see `match`; where it leaves too few pairs, a looser one is tried.
            threshold, min_inliers, confidence: see `pnp.solve_pnp`.

        Returns:
            Its pose with covariance; or none, with the reason. It has no pose where too few features agree.

        Raises:
            ValueError: an image of another shape, type or size than the intrinsics', or settings out of range.
        """
        check_size(check_image(image), intrinsics, "image")
        if not 0.0 < ratio <= 1.0:
            raise ValueError(f"ratio: expected a number in (0, 1], got {ratio}")
        found = extract(image, self.kind, n, mask)
        distances = self._distances(found.descriptors)

        def solve(T_start: ArrayLike | None = None, spread: float | None = None) -> PnPResult:
            return solve_pnp(
                self.points[points], found.pixels[rows], intrinsics, threshold, min_inliers, confidence,
                T_guess=T_start, spread=spread,
            )  # fmt: skip

        for limit in (ratio, max(ratio, LOOSE)):  # more pairs, and more wrong ones, where the few give no pose
            rows, points = _pair(distances, limit)
            solved = solve(T_guess)
            if solved.T_c_object is not None:
                break
        if solved.T_c_object is None and T_guess is not None:
            # What lies near where it was expected need only differ from what else would lie there.
            near = self._near(found.pixels, T_guess, intrinsics, SEARCH)
            rows, points = _pair(np.where(near, distances, np.inf), ratio)
            solved = solve(T_guess, SEARCH)
        if solved.T_c_object is not None:
            # More of the object's features, now that it is known where they must be, for a better pose.
            farthest = np.quantile(distances[rows, points][solved.inliers], 0.9)
            near = self._near(found.pixels, solved.T_c_object, intrinsics, threshold)
            more = _pair(np.where(near & (distances <= farthest), distances, np.inf), 1.0)
            if len(more[0]) > solved.inliers.sum():
                kept, (rows, points) = (rows, points), more
                again = solve(solved.T_c_object)
                if again.inliers.sum() > solved.inliers.sum():
                    solved = again
                else:
                    rows, points = kept
        inside, pixels = solved.inliers, found.pixels[rows]
        return FeaturePose(
            solved.T_c_object, int(inside.sum()), len(rows), points[inside], pixels[inside], solved.rmse,
            solved.covariance, solved.reason,
        )  # fmt: skip

    def _near(self, pixels: Array, T_c_object: ArrayLike, intrinsics: Intrinsics, radius: float) -> NDArray[np.bool_]:
        """(F, N) whether a pixel lies within `radius` [px] of where a point would be seen."""
        where = pinhole(transform_points(check_transform(T_c_object, "T_guess"), self.points), intrinsics)
        gap = undistorted(pixels, intrinsics)[:, None] - np.nan_to_num(where, nan=np.inf)
        return (gap**2).sum(axis=-1) <= radius**2

    def box(self, T_c_object: ArrayLike, intrinsics: Intrinsics) -> Array | None:
        """(4,) xyxy [px] of all points' pixels within the image; None where the object is not in view."""
        pixels = project(self.points, intrinsics, check_transform(T_c_object, "T_c_object"))
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if not len(pixels):
            return None
        limit = np.array([intrinsics.width - 1.0, intrinsics.height - 1.0])
        low, high = np.clip(pixels.min(axis=0), 0.0, limit), np.clip(pixels.max(axis=0), 0.0, limit)
        return np.concatenate([low, high]) if (low < high).all() else None


def _pair(distances: NDArray[np.float32], ratio: float) -> tuple[Ints, Ints]:
    """Rows and columns of the finite smallest entries of rows, below `ratio` times the row's next, each column once."""
    if not distances.size:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    best = distances.argmin(axis=1)
    every = np.arange(len(distances))
    least = distances[every, best]
    others = distances.copy()
    others[every, best] = np.inf
    rows = np.nonzero(np.isfinite(least) & (least < ratio * others.min(axis=1)))[0]
    rows = rows[np.argsort(least[rows], kind="stable")]
    _, first = np.unique(best[rows], return_index=True)  # the closest of those that resemble one point
    rows = rows[np.sort(first)]
    return rows, best[rows]


def _line(fault: BaseException) -> str:
    return " ".join(str(fault).split())[:200] if str(fault) else type(fault).__name__
