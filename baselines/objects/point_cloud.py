"""An object as the points that were seen of it: cleaned, thinned, and given normals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerograsp_env.interfaces import Intrinsics
from aerograsp_env.spatial import as_array, check_transform, transform_points
from baselines.objects.cloud_files import read_cloud, write_ply
from baselines.objects.depth_points import FARTHEST, unproject
from baselines.objects.normals import estimate_normals, estimate_organized_normals
from baselines.objects.observations import UNIT_TOLERANCE
from baselines.objects.sampling import farthest_point_indices, group_means, inliers, voxel_groups

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def _frozen(array: NDArray) -> NDArray:
    array = array.view()
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class PointCloudObject:
    """Points in metres in one frame, with what is known of each.

    An organised cloud also knows which pixel of an H × W image each of its points comes from: `valid` marks the pixels
    that have a point, in row order. Whatever removes or mixes points forgets the image, except `crop` and
    `remove_outliers`, which clear pixels.

    Raises:
        ValueError: no points, values that are not finite, normals that are zero or not of unit length (to 1e-6),
            negative noise, or shapes that do not match.
    """

    points: Array  # (N, 3) [m]
    normals: Array | None = None  # (N, 3) unit, outward
    colors: NDArray[np.uint8] | None = None  # (N, 3) RGB
    noise: Array | None = None  # (N,) standard deviation of each point along its normal [m]
    viewpoint: Array | None = None  # (3,) [m] where it was seen from; None: the origin
    curvature: Array | None = None  # (N,) in [0, 1/3]: see `estimate_normals`
    valid: Mask | None = None  # (H, W) with N true pixels, or None for a cloud without an image

    def __post_init__(self) -> None:
        points = as_array(self.points, (3,), "points")
        if points.ndim != 2:
            raise ValueError(f"points: expected shape (N, 3), got {points.shape}")
        n = len(points)
        if n == 0:
            raise ValueError("points: expected at least one, got none")
        object.__setattr__(self, "points", _frozen(points))
        view = np.zeros(3) if self.viewpoint is None else as_array(self.viewpoint, (3,), "viewpoint")
        object.__setattr__(self, "viewpoint", _frozen(view))
        for name in ("normals", "noise", "curvature"):
            value = getattr(self, name)
            if value is None:
                continue
            shape = (n, 3) if name == "normals" else (n,)
            array = np.broadcast_to(value, n) if name == "noise" and np.ndim(value) == 0 else value
            array = as_array(array, shape, name)
            if array.shape != shape:
                raise ValueError(f"{name}: expected shape {shape} like the points, got {array.shape}")
            object.__setattr__(self, name, _frozen(array))
        if self.normals is not None:
            off = np.abs(np.linalg.norm(self.normals, axis=1) - 1.0)
            if (off > UNIT_TOLERANCE).any():
                row = int(off.argmax())
                length = float(np.linalg.norm(self.normals[row]))
                raise ValueError(f"normals: expected unit length (to {UNIT_TOLERANCE:g}), got {length:g} in row {row}")
        if self.noise is not None and (self.noise < 0.0).any():
            raise ValueError(f"noise: expected standard deviations ≥ 0 [m], got {self.noise.min():g}")
        if self.colors is not None:
            colors = np.asarray(self.colors)
            if colors.shape != (n, 3) or colors.dtype != np.uint8:
                raise ValueError(f"colors: expected uint8 of shape ({n}, 3), got {colors.dtype} {colors.shape}")
            object.__setattr__(self, "colors", _frozen(colors))
        if self.valid is not None:
            valid = np.asarray(self.valid)
            if valid.ndim != 2 or valid.dtype != np.bool_ or valid.sum() != n:
                got = f"{valid.dtype} {valid.shape} with {int(valid.sum())}"
                raise ValueError(f"valid: expected booleans (H, W), {n} of them true, got {got}")
            object.__setattr__(self, "valid", _frozen(valid))

    def __len__(self) -> int:
        return len(self.points)

    # --- making one -----------------------------------------------------------------------------------------------

    @classmethod
    def from_depth(
        cls, depth: ArrayLike, intrinsics: Intrinsics, rgb: Any = None, T: ArrayLike | None = None
    ) -> PointCloudObject:
        """Every pixel with a return, as an organised cloud.

        Args:
            depth: (H, W) [m] along the optical axis; 0 or NaN where there is no return.
            intrinsics: of the camera that `depth` belongs to. Lens distortion is undone.
            rgb: (H, W, 3) uint8, registered to the depth.
            T: (4, 4) maps camera coordinates to the frame wanted (T_world_camera); None: the camera's own.

        Raises:
            ValueError: sizes that do not match, negative or infinite depth, or no return at all.
        """
        points, valid = unproject(depth, intrinsics)
        colors = None
        if rgb is not None:
            image = np.asarray(rgb)
            if image.shape != (*valid.shape, 3) or image.dtype != np.uint8:
                raise ValueError(f"rgb: expected uint8 of shape {(*valid.shape, 3)}, got {image.dtype} {image.shape}")
            colors = image[valid]
        cloud = cls(points, colors=colors, valid=valid)
        return cloud if T is None else cloud.transform(T)

    @classmethod
    def from_file(cls, path: str | Path, scale: float | None = None) -> PointCloudObject:
        """Read .pcd (ascii, binary, compressed), .ply, .npy, .npz or .xyz; points that are not finite are left out.

        Normals are brought to unit length; if one is zero or not finite, all are left out (estimate them anew).

        Args:
            path: the file.
            scale: metres per unit of the file (0.001 for millimetres). None: metres, and a cloud more than 50 m from
                its viewpoint is refused.

        Raises:
            FileNotFoundError: no such file.
            ValueError: a file that cannot be read, holds no finite point, or is not in metres.
        """
        data = read_cloud(path)
        if scale is not None and not 0.0 < scale < np.inf:
            raise ValueError(f"scale: expected a positive number of metres per unit, got {scale}")
        keep = np.isfinite(data.points).all(axis=1)
        if not keep.any():
            raise ValueError(f"path: expected at least one finite point, got none in {Path(path).name}")
        view = np.zeros(3) if data.viewpoint is None else data.viewpoint
        points = data.points[keep]
        if scale is None:
            reach = float(np.median(np.linalg.norm(points - view, axis=1)))
            if reach > FARTHEST:
                raise ValueError(
                    f"path: expected metres, got points {reach:.4g} from the viewpoint in {Path(path).name}: looks "
                    "like millimetres; pass scale=0.001, or scale=1.0 if they are metres"
                )
        else:
            points, view = scale * points, scale * view
        normals = None
        if data.normals is not None:
            lengths = np.linalg.norm(data.normals[keep], axis=1, keepdims=True)
            if (np.isfinite(lengths) & (lengths > 0.0)).all():
                normals = data.normals[keep] / lengths
        valid = None if data.shape is None else np.reshape(keep, data.shape)
        colors = None if data.colors is None else data.colors[keep]
        return cls(points, normals, colors, viewpoint=view, valid=valid)

    def write_ply(self, path: str | Path) -> None:
        """Write points, normals and colours as binary PLY, replacing the file at once or not at all."""
        write_ply(path, self.points, self.normals, self.colors)

    # --- measuring ------------------------------------------------------------------------------------------------

    @property
    def extents(self) -> Array:
        """(3,) [m] size of the axis-aligned bounding box."""
        return np.ptp(self.points, axis=0)

    def grid(self) -> Array:
        """(H, W, 3) [m] points in their image, NaN where there is none; an organised cloud only."""
        if self.valid is None:
            raise ValueError("grid: expected an organised cloud, got one without an image")
        out = np.full((*self.valid.shape, 3), np.nan)
        out[self.valid] = self.points
        return out

    def estimate_normals(
        self, neighbors: int | None = 20, radius: float | None = None, window: int | None = None
    ) -> PointCloudObject:
        """The cloud with unit normals towards its viewpoint, and curvature; points that can have none are left out.

        Args:
            neighbors: how many nearest points make a normal.
            radius: [m] how far they may be; alone (neighbors=None) all within it count.
            window: pixels of an organised cloud; if given, normals come from windows of the image, about twice as
                fast, and points whose window straddles a jump of depth are left out.

        Raises:
            ValueError: arguments out of range, or no point that can have a normal (all collinear or coinciding).
        """
        assert self.viewpoint is not None
        if window is None:
            found = estimate_normals(self.points, self.viewpoint, neighbors, radius)
            normals, curvature, valid = found
        else:
            if self.valid is None:
                raise ValueError("window: expected an organised cloud, got one without an image")
            flat = self.valid.ravel()
            found = estimate_organized_normals(self.grid(), self.valid, self.viewpoint, window)
            normals, curvature, valid = found.normals[flat], found.curvature[flat], found.valid[flat]
        if not valid.any():
            raise ValueError(
                "points: expected some that span a surface, got none with a normal (collinear or coinciding)"
            )
        kept = self.select(valid)
        return replace(kept, normals=normals[valid], curvature=curvature[valid])

    # --- choosing points ------------------------------------------------------------------------------------------

    def select(self, which: ArrayLike) -> PointCloudObject:
        """Some of the points, by a mask (N,), which keeps the image, or by indices, which does not.

        Raises:
            ValueError: a mask of another length, indices out of range, or nothing chosen.
        """
        chosen = np.asarray(which)
        if chosen.dtype == np.bool_ and chosen.shape != (len(self),):
            raise ValueError(f"which: expected a mask of shape ({len(self)},), got {chosen.shape}")
        if chosen.dtype != np.bool_ and chosen.size and (chosen.min() < 0 or chosen.max() >= len(self)):
            raise ValueError(f"which: expected indices in [0, {len(self) - 1}], got {chosen.min()} … {chosen.max()}")
        if not chosen.any() if chosen.dtype == np.bool_ else chosen.size == 0:
            raise ValueError("which: expected at least one point, got none")
        valid = None
        if chosen.dtype == np.bool_ and self.valid is not None:
            valid = self.valid.copy()
            valid[self.valid] = chosen
        parts: dict[str, Any] = {"valid": valid}
        for name in ("points", "normals", "colors", "noise", "curvature"):
            part = getattr(self, name)
            parts[name] = None if part is None else part[chosen]
        return replace(self, **parts)

    def voxel_downsample(self, size: float) -> PointCloudObject:
        """One point for each occupied voxel of edge `size` [m]: the means of points, normals, colours and noise.

        Normals are averaged and brought back to unit length; where they cancel, the voxel keeps its first one.
        """
        group, count = voxel_groups(self.points, size)
        _, first = np.unique(group, return_index=True)
        normals = None
        if self.normals is not None:
            normals = group_means(self.normals, group, count)
            lengths = np.linalg.norm(normals, axis=1, keepdims=True)
            normals = np.where(lengths > 1e-6, normals / np.maximum(lengths, 1e-6), self.normals[first])
        colors = None
        if self.colors is not None:
            colors = np.rint(group_means(self.colors.astype(np.float64), group, count)).astype(np.uint8)
        noise = None if self.noise is None else group_means(self.noise[:, None], group, count)[:, 0]
        curvature = None if self.curvature is None else group_means(self.curvature[:, None], group, count)[:, 0]
        return PointCloudObject(
            group_means(self.points, group, count), normals, colors, noise, self.viewpoint, curvature
        )

    def voxel_representatives(self, size: float) -> NDArray[np.int64]:
        """Index of the point nearest to the mean of each occupied voxel of edge `size` [m]."""
        group, count = voxel_groups(self.points, size)
        gap = np.linalg.norm(self.points - group_means(self.points, group, count)[group], axis=1)
        order = np.lexsort((gap, group))
        return np.sort(order[np.unique(group[order], return_index=True)[1]])

    def farthest_point_sample(self, n: int, rng: np.random.Generator | None = None) -> PointCloudObject:
        """n points, each the farthest from those before it; the first is drawn from rng, or is the cloud's first."""
        first = 0 if rng is None else int(rng.integers(len(self)))
        return self.select(farthest_point_indices(self.points, n, first))

    def remove_outliers(self, neighbors: int = 20, deviations: float = 2.0) -> PointCloudObject:
        """Without points far from their neighbours: see `sampling.inliers`."""
        return self.select(inliers(self.points, neighbors, deviations))

    def crop(self, lower: ArrayLike, upper: ArrayLike) -> PointCloudObject:
        """The points inside a box, borders included.

        Raises:
            ValueError: corners (3,) in the wrong order, or no point inside.
        """
        low, high = as_array(lower, (3,), "lower"), as_array(upper, (3,), "upper")
        if (low > high).any():
            raise ValueError(f"upper: expected a corner above {low}, got {high}")
        return self.select(((self.points >= low) & (self.points <= high)).all(axis=1))

    def transform(self, T: ArrayLike) -> PointCloudObject:
        """The cloud in another frame: T (4, 4) rigid, maps this frame's coordinates to the new one's."""
        T = check_transform(T)
        assert self.viewpoint is not None
        normals = None if self.normals is None else self.normals @ T[:3, :3].T
        if normals is not None:  # rotations are exact to 1e-6 only
            normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return replace(
            self,
            points=transform_points(T, self.points),
            normals=normals,
            viewpoint=transform_points(T, self.viewpoint),
        )
