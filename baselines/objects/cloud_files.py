"""Point cloud files: PCD (ascii, binary, compressed), PLY, NPY and NPZ, and plain columns. Nothing is unpickled."""

from __future__ import annotations

import os
import tempfile
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class CloudData(NamedTuple):
    """What a file holds; missing points (organised clouds) are rows of NaN."""

    points: Array  # (N, 3)
    normals: Array | None  # (N, 3)
    colors: NDArray[np.uint8] | None  # (N, 3)
    viewpoint: Array | None  # (3,)
    shape: tuple[int, int] | None  # (H, W) of an organised cloud


def read_cloud(path: str | Path) -> CloudData:
    """Read a cloud by its file name's ending: .pcd, .ply, .npy (N, 3), .npz ("points", "normals"), .xyz or .txt.

    Raises:
        FileNotFoundError: no such file.
        ValueError: an unknown ending, or a file that is cut short, malformed, or without x, y and z.
    """
    path = Path(path)
    readers = {".pcd": _read_pcd, ".ply": _read_ply, ".npy": _read_npy, ".npz": _read_npy, ".xyz": _read_columns}
    readers[".txt"] = _read_columns
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"path: expected an ending among {', '.join(sorted(readers))}, got {path.name}")
    if not path.is_file():
        raise FileNotFoundError(f"path: no file {path}")
    try:
        return reader(path)
    except (ValueError, KeyError, IndexError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"path: expected a readable point cloud, got {path.name}: {error}") from error


# --- PCD (pointclouds.org, "The PCD file format", version 0.7) --------------------------------------------------------


def _decompress_lzf(data: bytes, size: int) -> bytes:
    """LZF (Lehmann's liblzf): a literal run, or a copy of what was written before."""
    out = bytearray()
    i = 0
    while i < len(data):
        control = data[i]
        i += 1
        if control < 32:
            out += data[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[i]
            i += 1
        start = len(out) - ((control & 31) << 8) - data[i] - 1
        i += 1
        length += 2
        if start < 0:
            raise ValueError("compressed data refer to before their beginning")
        while length > 0:  # the copy may overlap what it writes
            piece = out[start : start + length]
            out += piece
            start += len(piece)
            length -= len(piece)
    if len(out) != size:
        raise ValueError(f"expected {size} bytes after decompression, got {len(out)}")
    return bytes(out)


def _read_pcd(path: Path) -> CloudData:
    content = path.read_bytes()
    header: dict[str, list[str]] = {}
    place = 0
    while "DATA" not in header:
        end = content.find(b"\n", place)
        if end < 0:
            raise ValueError("header without a DATA line")
        words = content[place:end].decode("ascii", errors="replace").split("#")[0].split()
        place = end + 1
        if words:
            header[words[0].upper()] = words[1:]
    names = [name.lower() for name in header["FIELDS"]]
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(names))]
    kinds = {"F": "f", "U": "u", "I": "i"}
    formats = [f"<{kinds[t.upper()]}{int(s)}" for t, s in zip(header["TYPE"], header["SIZE"], strict=True)]
    width, height = int(header["WIDTH"][0]), int(header["HEIGHT"][0])
    n = int(header["POINTS"][0]) if "POINTS" in header else width * height
    if n < 0 or width * height != n:
        raise ValueError(f"expected WIDTH × HEIGHT points, got {width} × {height} and POINTS {n}")
    keys = [f"{name}#{i}" for i, name in enumerate(names)]  # padding fields share the name "_"
    dtype = np.dtype([(k, f, (c,)) for k, f, c in zip(keys, formats, counts, strict=True)])
    body = content[place:]
    mode = header["DATA"][0].lower()
    if mode == "ascii":
        rows = [line.split() for line in body.decode("ascii").splitlines() if line.strip()]
        if len(rows) < n or any(len(row) != sum(counts) for row in rows[:n]):
            raise ValueError(
                f"expected {n} rows of {sum(counts)} values, got {len(rows)} rows or a row of other length"
            )
        offsets = np.concatenate([[0], np.cumsum(counts)])
        columns = {}
        for i, name in enumerate(names):
            text = [row[offsets[i]] for row in rows[:n]]
            columns[name] = np.array(text, dtype=np.float64)
            if name in ("rgb", "rgba"):
                columns[name] = _packed(columns[name], formats[i])
    else:
        if mode == "binary_compressed":
            packed, size = np.frombuffer(body[:8], dtype="<u4")
            body = _decompress_lzf(body[8 : 8 + int(packed)], int(size))
        elif mode != "binary":
            raise ValueError(f"expected DATA ascii, binary or binary_compressed, got {mode}")
        if len(body) < n * dtype.itemsize:
            raise ValueError(f"expected {n * dtype.itemsize} bytes of data, got {len(body)}")
        columns = {}
        place = 0
        table = np.frombuffer(body, dtype=dtype, count=n) if mode == "binary" else None
        for key, name, form, count in zip(keys, names, formats, counts, strict=True):
            if table is not None:
                column = table[key][:, 0]
            else:  # compressed files hold one field after the other
                column = np.frombuffer(body, dtype=form, count=n * count, offset=place)[::count]
                place += n * count * np.dtype(form).itemsize
            columns[name] = _packed(column, form) if name in ("rgb", "rgba") else column.astype(np.float64)
    view = np.array(header["VIEWPOINT"][:3], dtype=np.float64) if "VIEWPOINT" in header else None
    data = _assemble(columns, ("normal_x", "normal_y", "normal_z"))
    return data._replace(viewpoint=view, shape=(height, width) if height > 1 else None)


def _packed(column: NDArray, form: str) -> NDArray:
    """0xAARRGGBB as whole numbers, which files also hold in the bits of a float32."""
    if form[1] == "f":
        return column.astype(np.float32).view(np.uint32).astype(np.int64)
    return column.astype(np.int64)


def _assemble(columns: dict[str, NDArray], normal_names: tuple[str, str, str]) -> CloudData:
    """A cloud from named columns."""
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise ValueError(f"expected fields x, y and z, got {', '.join(columns)}")
    points = np.stack([np.asarray(columns[name], dtype=np.float64) for name in "xyz"], axis=1)
    normals = colors = None
    if all(name in columns for name in normal_names):
        normals = np.stack([np.asarray(columns[name], dtype=np.float64) for name in normal_names], axis=1)
    packed = columns.get("rgb", columns.get("rgba"))
    if packed is not None:
        colors = np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=1).astype(np.uint8)
    elif all(name in columns for name in ("red", "green", "blue")):
        rgb = np.stack([columns[name] for name in ("red", "green", "blue")], axis=1)
        colors = (rgb * 255 if rgb.dtype.kind == "f" and rgb.max(initial=0) <= 1 else rgb).astype(np.uint8)
    return CloudData(points, normals, colors, None, None)


# --- PLY --------------------------------------------------------------------------------------------------------------

_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}


def _read_ply(path: Path) -> CloudData:
    """The vertices, which must be the file's first element (as all known writers have them)."""
    content = path.read_bytes()
    end = content.find(b"end_header")
    if not content.startswith(b"ply") or end < 0:
        raise ValueError("expected a PLY header")
    lines = [line.split() for line in content[:end].decode("ascii", errors="replace").splitlines()]
    place = content.index(b"\n", end) + 1
    form = next(words[1] for words in lines if words[:1] == ["format"])
    elements = [words for words in lines if words[:1] == ["element"]]
    if not elements or elements[0][1] != "vertex":
        raise ValueError("expected vertices as the first element")
    n = int(elements[0][2])
    first = lines.index(elements[0])
    last = lines.index(elements[1]) if len(elements) > 1 else len(lines)
    properties = [words for words in lines[first + 1 : last] if words[:1] == ["property"]]
    if any(words[1] == "list" for words in properties):
        raise ValueError("expected vertices without lists")
    order = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    dtype = np.dtype([(words[2], order + _PLY_TYPES[words[1]]) for words in properties])
    if form == "ascii":
        rows = [line.split() for line in content[place:].decode("ascii").splitlines() if line.strip()][:n]
        if len(rows) < n or any(len(row) < len(properties) for row in rows):
            raise ValueError(f"expected {n} vertices of {len(properties)} values, got fewer")
        table = np.array([tuple(row[: len(properties)]) for row in rows], dtype=dtype)
    else:
        if len(content) - place < n * dtype.itemsize:
            raise ValueError(f"expected {n * dtype.itemsize} bytes of vertices, got {len(content) - place}")
        table = np.frombuffer(content, dtype=dtype, count=n, offset=place)
    return _assemble({name: table[name] for name in dtype.names or ()}, ("nx", "ny", "nz"))


def write_ply(path: str | Path, points: Array, normals: Array | None, colors: NDArray[np.uint8] | None) -> None:
    """Binary PLY of points, normals and colours, each (N, 3); replaces the file at once, or not at all."""
    fields = [(name, "<f8") for name in "xyz"]
    fields += [(name, "<f8") for name in ("nx", "ny", "nz")] if normals is not None else []
    fields += [(name, "u1") for name in ("red", "green", "blue")] if colors is not None else []
    table = np.empty(len(points), dtype=fields)
    stack = [array for array in (points, normals, colors) if array is not None]
    for (name, _), column in zip(fields, (column for array in stack for column in array.T), strict=True):
        table[name] = column
    kinds = {"<f8": "double", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property {kinds[kind]} {name}" for name, kind in fields] + ["end_header", ""]
    path = Path(path)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write("\n".join(header).encode("ascii") + table.tobytes())
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


# --- arrays and columns -----------------------------------------------------------------------------------------------


def _read_npy(path: Path) -> CloudData:
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return _from_columns(loaded)
    with loaded as archive:
        parts = {name: archive[name] for name in ("points", "normals", "colors", "viewpoint") if name in archive.files}
    if "points" not in parts:
        raise ValueError('expected an array named "points"')
    data = _from_columns(parts["points"])
    colors = parts["colors"].astype(np.uint8) if "colors" in parts else data.colors
    return data._replace(normals=parts.get("normals", data.normals), colors=colors, viewpoint=parts.get("viewpoint"))


def _read_columns(path: Path) -> CloudData:
    return _from_columns(np.loadtxt(path, dtype=np.float64, ndmin=2, delimiter="," if _has_commas(path) else None))


def _has_commas(path: Path) -> bool:
    with path.open("rb") as file:
        return b"," in file.readline()


def _from_columns(table: NDArray) -> CloudData:
    """Points from (N, 3), with normals from (N, 6), or an organised cloud from (H, W, 3)."""
    table = np.asarray(table, dtype=np.float64)
    if table.ndim == 3 and table.shape[2] == 3:
        return CloudData(table.reshape(-1, 3), None, None, None, (table.shape[0], table.shape[1]))
    if table.ndim != 2 or table.shape[1] not in (3, 6):
        raise ValueError(f"expected shape (N, 3), (N, 6) or (H, W, 3), got {table.shape}")
    return CloudData(table[:, :3], table[:, 3:] if table.shape[1] == 6 else None, None, None, None)
