"""The page of a grasp plan: a scene that one can turn, the ranked table below it, and all that it needs inside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerograsp_env.interfaces import Grasp
from aerograsp_env.sim.gripper import GripperConfig, gripper_pose
from aerograsp_env.spatial import transform_points
from agents import page as html

Array = NDArray[np.float64]
Faces = NDArray[np.integer]

RANK_COLORS = np.array([[13, 60, 140], [31, 120, 180], [65, 182, 196], [161, 218, 180]])  # best … last
SURFACE = "#b9c0c8"
UNSURE = [[0.0, "#c9cfd6"], [0.35, "#f2c46d"], [0.7, "#e0652f"], [1.0, "#8f1d2c"]]
LEAST_UNSURE = 2.0  # [mm] a surface that is known better everywhere does not look unsure
COINCIDENT = 0.003  # of a shell's size: nearer to the surface it is not drawn
SHELLS = {1: "#8a6fc4", -1: "#3c9d6e"}  # outer, inner
GREY = "#838b95"  # legible on light and on dark pages
_BOX_CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=np.float64)
_BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]]
    + [[1, 5, 7], [1, 7, 3]]
)
_LIGHT = {"ambient": 0.55, "diffuse": 0.75, "specular": 0.1, "roughness": 0.85, "fresnel": 0.05}
_LIGHT.update(facenormalsepsilon=0.0, vertexnormalsepsilon=0.0)  # by default small faces count as having no normal

STYLE = """<style>
main { max-width: 82rem; padding-top: 2rem; }
#plan { height: min(74vh, 52rem) !important; min-height: 26rem; border: 1px solid var(--line); border-radius: 8px; }
.choose button { font: inherit; font-size: .86rem; color: var(--ink); background: var(--card); cursor: pointer;
  border: 1px solid var(--line); border-radius: 6px; padding: .2rem .8rem; margin-right: .3rem; }
#grasps tbody tr { cursor: pointer; } #grasps tbody tr:hover td { background: var(--card); }
#grasps tbody tr.shown td { background: var(--best); }
.swatch { display: inline-block; width: .8em; height: .8em; border-radius: 2px; margin-right: .5em; }
</style>"""

SCRIPT = """<script>
(function () {
  const scene = document.getElementById("plan");
  const rows = Array.from(document.querySelectorAll("#grasps tbody tr"));
  const traces = scene.data.map((trace, i) => [i, (trace.meta || {}).grasp]).filter(pair => pair[1] !== undefined);
  let shown = new Set([0]);
  function mark() { rows.forEach((row, k) => row.classList.toggle("shown", shown.has(k))); }
  function show(wanted) {
    shown = new Set(wanted);
    Plotly.restyle(scene, {visible: traces.map(pair => shown.has(pair[1]) ? true : "legendonly")},
                   traces.map(pair => pair[0]));
    mark();
  }
  rows.forEach((row, k) => {
    row.tabIndex = 0;
    row.addEventListener("click", () => show([k]));
    row.addEventListener("keydown", event => { if (event.key === "Enter") show([k]); });
  });
  const all = rows.map((_, k) => k);
  for (const [name, which] of [["best", all.slice(0, 1)], ["all", all], ["none", []]])
    document.getElementById("show-" + name).addEventListener("click", () => show(which));
  scene.on("plotly_restyle", () => {
    shown = new Set(traces.filter(pair => scene.data[pair[0]].visible === true).map(pair => pair[1]));
    mark();
  });
  mark();
})();
</script>"""


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh to draw."""

    vertices: Array  # (V, 3) [m]
    faces: Faces  # (F, 3)
    deviation: Array | None = None  # (V,) [m] standard deviation of the surface there


@dataclass(frozen=True, eq=False)
class Scene:
    """What is drawn under the grasps, in one frame."""

    surface: Surface | None  # the object, known or estimated
    points: Array | None = None  # (N, 3) [m] what was seen of it
    shells: Mapping[float, Surface] | None = None  # number of standard deviations → the level set there
    viewpoint: Array | None = None  # (3,) [m] where it was seen from
    center: Array | None = None  # (3,) [m] of mass, or its estimate


@dataclass(frozen=True, eq=False)
class DrawnGrasp:
    """A grasp, its contacts, and what the table says of it."""

    grasp: Grasp
    positions: Array  # (2, 3) [m]
    normals: Array  # (2, 3) unit, into the object
    cells: tuple[str, ...]  # one for each of the table's columns


def rank_color(index: int, count: int) -> str:
    """The colour of the grasp at `index` of `count`: dark blue for the best, pale green for the last."""
    place = index / max(count - 1, 1) * (len(RANK_COLORS) - 1)
    red, green, blue = (np.interp(place, np.arange(len(RANK_COLORS)), RANK_COLORS[:, k]) for k in range(3))
    return f"#{round(red):02x}{round(green):02x}{round(blue):02x}"


def gripper_mesh(grasp: Grasp, gripper: GripperConfig) -> Surface:
    """The boxes of the gripper, open as the grasp says, in the grasp's frame: 40 vertices, 60 faces."""
    boxes = gripper.boxes(min(grasp.width, gripper.max_width))
    corners = np.concatenate([box.center + _BOX_CORNERS * box.half_size for box in boxes])
    faces = np.concatenate([_BOX_FACES + 8 * k for k in range(len(boxes))])
    return Surface(transform_points(gripper_pose(grasp), corners), faces)


def figure(
    scene: Scene, grasps: Sequence[DrawnGrasp], columns: Sequence[str], gripper: GripperConfig
) -> dict[str, Any]:
    """Scene and grasps as a plotly figure. What belongs to grasp k has `meta` {"grasp": k}; only the first is shown."""
    traces: list[dict[str, Any]] = []
    if scene.surface is not None:
        traces.append(_object_trace(scene.surface, seen=scene.points is not None))
    for sigma, shell in sorted((scene.shells or {}).items()):
        shell = _apart(shell)
        if not len(shell.faces):
            continue
        color = SHELLS[1 if sigma > 0.0 else -1]
        name = f"{'+' if sigma > 0.0 else '−'}{abs(sigma):g} σ shell"
        traces.append({**_mesh(shell), "name": name, "color": color, "opacity": 0.16, "showlegend": True})
        traces[-1].update(hoverinfo="skip", lighting=_LIGHT, legendgroup=name)
    if scene.points is not None:
        traces.append(_markers(scene.points, f"{len(scene.points)} points seen", 2.2, "#30363d" if grasps else GREY))
    if scene.center is not None:
        label = "centre of mass" if scene.points is None else "centre of the estimate"
        traces.append(_markers(scene.center[None], label, 5, "#c2185b", "cross"))
    for k, drawn in enumerate(grasps):
        traces += _grasp_traces(k, drawn, columns, gripper, rank_color(k, len(grasps)))
    camera = _camera(scene, grasps)
    eye, up = (np.array([camera[key][name] for name in "xyz"]) for key in ("eye", "up"))
    light = 1e5 * (eye + up + 0.7 * np.cross(up, eye)) / 5.0  # over the first viewer's shoulder; plotly's bound is 1e5
    for trace in traces:
        if trace["type"] == "mesh3d":
            trace["lightposition"] = dict(zip("xyz", light.tolist(), strict=True))
    axes = {
        f"{name}axis": {
            "title": {"text": f"{name} [m]"},
            "backgroundcolor": "rgba(0,0,0,0)",
            "gridcolor": "#aab1b9",
            "zerolinecolor": "#838b95",
            "showspikes": False,
        }
        for name in "xyz"
    }
    layout = {
        "scene": {**axes, "aspectmode": "data", "camera": camera},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "font": {"color": GREY, "family": "system-ui, sans-serif"},
        "legend": {"x": 0.01, "y": 0.99, "bgcolor": "rgba(0,0,0,0)", "groupclick": "togglegroup", "tracegroupgap": 2},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": GREY, "activecolor": "#1f78b4"},
        "uirevision": "kept",  # the camera stays where it was turned to
    }
    return {"data": traces, "layout": layout}


def plan_page(
    title: str,
    lead: str,
    scene: Scene,
    grasps: Sequence[DrawnGrasp],
    columns: Sequence[str],
    gripper: GripperConfig,
    notes: Sequence[str],
    facts: Mapping[str, Any],
) -> str:
    """The page as one HTML document that loads nothing: plotly's script is inside it.

    Args:
        title: heading of the page.
        lead: the sentence below it.
        scene, grasps: in one frame; the best grasp first.
        columns: heads of the table, one for each of a grasp's `cells`.
        gripper: how the grasps are drawn.
        notes: small print below the table.
        facts: where the plan comes from.

    Raises:
        ModuleNotFoundError: plotly is not installed.
        ValueError: a grasp whose cells do not match the columns.
    """
    from plotly.io import to_html

    if any(len(drawn.cells) != len(columns) for drawn in grasps):
        raise ValueError(f"grasps: expected {len(columns)} cells each, one for each column, got another number")
    options = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": ["orbitRotation"]}
    drawing = to_html(
        figure(scene, grasps, columns, gripper), config=options, include_plotlyjs=True, full_html=False, div_id="plan"
    )
    parts = [STYLE, f'<p class="lead">{html.text(lead)}</p>', drawing]
    if grasps:
        buttons = "".join(f'<button id="show-{name}">{name}</button>' for name in ("best", "all", "none"))
        rows = []
        for k, drawn in enumerate(grasps):
            swatch = f'<span class="swatch" style="background:{rank_color(k, len(grasps))}"></span>'
            rows.append(html.table_row([f"{swatch}{k + 1}", *map(html.text, drawn.cells)]))
        parts += ["<h2>Grasps</h2>", f'<p class="choose">Show {buttons} or click a row to see that grasp alone.</p>']
        parts += [f'<div id="grasps">{html.table(["rank", *columns], rows)}</div>', SCRIPT]
    parts += [html.notes(notes) if notes else "", "<h2>Provenance</h2>", html.facts(facts)]
    return html.page(title, parts)


def _mesh(surface: Surface) -> dict[str, Any]:
    """float32 and int32 halve the page, and are finer than a screen."""
    x, y, z = surface.vertices.T.astype(np.float32)
    i, j, k = surface.faces.T.astype(np.int32)
    return {"type": "mesh3d", "x": x, "y": y, "z": z, "i": i, "j": j, "k": k}


def _apart(shell: Surface) -> Surface:
    """The part of a shell that is clear of the surface; the rest coincides with it, and would flicker."""
    if shell.deviation is None:
        return shell
    clear = shell.deviation[shell.faces].max(axis=1) > COINCIDENT * np.ptp(shell.vertices, axis=0).max()
    return Surface(shell.vertices, shell.faces[clear])


def _object_trace(surface: Surface, seen: bool) -> dict[str, Any]:
    trace = {**_mesh(surface), "name": "estimated surface" if seen else "object", "lighting": _LIGHT}
    trace.update(showlegend=True, flatshading=not seen, opacity=1.0)
    if surface.deviation is None:
        return {**trace, "color": SURFACE, "hoverinfo": "skip"}
    return {
        **trace,
        "intensity": (1e3 * surface.deviation).astype(np.float32),
        "colorscale": UNSURE,
        "cmin": 0.0,
        "cmax": float(max(1e3 * surface.deviation.max(), LEAST_UNSURE)),
        "colorbar": {"title": {"text": "std of the<br>surface [mm]"}, "thickness": 12, "len": 0.6, "x": 0.99},
        "hovertemplate": "std %{intensity:.1f} mm<extra></extra>",
    }


def _markers(points: Array, name: str, size: float, color: str, symbol: str = "circle") -> dict[str, Any]:
    x, y, z = points.T.astype(np.float32)
    marker = {"size": size, "color": color, "symbol": symbol}
    return {
        **{"type": "scatter3d", "mode": "markers", "x": x, "y": y, "z": z},
        **{"name": name, "marker": marker, "hoverinfo": "name", "showlegend": True},
    }


def _grasp_traces(
    k: int, drawn: DrawnGrasp, columns: Sequence[str], gripper: GripperConfig, color: str
) -> list[dict[str, Any]]:
    """The gripper, and its contacts with an arrow into the object each, which tells how the fingers push."""
    common: dict[str, Any] = {
        **{"legendgroup": f"grasp {k + 1}", "meta": {"grasp": k}, "visible": True if k == 0 else "legendonly"},
        "hovertemplate": "<br>".join(
            [f"<b>grasp {k + 1}</b>", *(f"{head}: {cell}" for head, cell in zip(columns, drawn.cells, strict=True))]
        )
        + "<extra></extra>",
    }
    body = {**_mesh(gripper_mesh(drawn.grasp, gripper)), **common, "name": f"grasp {k + 1}", "color": color}
    body.update(flatshading=True, opacity=0.72, showlegend=True, lighting=_LIGHT)
    length = 0.35 * gripper.finger_length
    gap = np.full(3, np.nan)
    line = np.concatenate(
        [[p - length * n, p + length * n, gap] for p, n in zip(drawn.positions, drawn.normals, strict=True)]
    )
    x, y, z = line.T.astype(np.float32)
    arrows = {"type": "scatter3d", "mode": "lines", "x": x, "y": y, "z": z, "name": "normals", "showlegend": False}
    arrows.update(**common, line={"color": "#d6336c", "width": 4})
    spots = {**_markers(drawn.positions, "contacts", 5, "#d6336c"), **common, "showlegend": False}
    spots.pop("hoverinfo")
    tips, along = drawn.positions + length * drawn.normals, drawn.normals
    heads = {"type": "cone", "showscale": False, "sizemode": "absolute", "sizeref": 0.3 * length, "anchor": "tip"}
    heads.update({axis: tips[:, i].astype(np.float32) for i, axis in enumerate("xyz")})
    heads.update({axis: along[:, i].astype(np.float32) for i, axis in enumerate("uvw")})
    heads.update(**common, name="normals", showlegend=False, colorscale=[[0.0, "#d6336c"], [1.0, "#d6336c"]])
    return [body, arrows, spots, heads]


def _camera(scene: Scene, grasps: Sequence[DrawnGrasp]) -> dict[str, Any]:
    """From the side of the viewer, who sees what the sensor saw; else across the best grasp, from behind its palm."""
    toward, up, distance = np.array([1.5, -1.8, 1.0]), np.array([0.0, 0.0, 1.0]), 2.2
    if scene.viewpoint is not None and scene.points is not None:
        toward = scene.viewpoint - scene.points.mean(axis=0)
        toward = toward / np.linalg.norm(toward)
        if toward[2] < -0.7:  # looked along +z: the frame of a camera, whose y points down
            up = np.array([0.0, -1.0, 0.0])
        elif toward[2] > 0.7:
            up = np.array([0.0, 1.0, 0.0])
        toward = toward + 0.35 * np.cross(up, toward) + 0.25 * up
    elif grasps:
        best = grasps[0].grasp
        across = np.cross(best.approach_axis, best.closing_axis)
        toward = (1.0 if across[2] >= 0.0 else -1.0) * across - 0.6 * best.approach_axis + 0.3 * best.closing_axis
        toward = toward + 0.25 * up
    eye = distance * toward / np.linalg.norm(toward)
    return {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "up": dict(zip("xyz", up.tolist(), strict=True))}
