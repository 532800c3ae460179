"""Cameras behind one interface: data sets written here, recorded ones, and devices whose packages stand in."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from aerograsp_env.cameras import CameraError, DatasetCamera, MissingPackage, open_camera
from aerograsp_env.cameras.ros import Partners, camera_info, depths, picture
from agents.reproduction import data_folder

DATA = data_folder()
needs_data = pytest.mark.skipif(not (DATA / "rgbd_7scenes").is_dir(), reason="real data not present")
H, W = 24, 32
INTRINSICS = {"width": W, "height": H, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5}


def images(index: int) -> tuple[np.ndarray, np.ndarray]:
    """A colour picture and a depth picture [m] that say which frame they are of."""
    rgb = np.full((H, W, 3), (10 * index, 50, 200), np.uint8)
    depth = np.full((H, W), 1.0 + 0.1 * index)
    depth[:2] = 0.0
    return rgb, depth


def save(rgb: np.ndarray, depth: np.ndarray, color_path: Path, depth_path: Path, unit: float) -> None:
    Image.fromarray(rgb).save(color_path)
    Image.fromarray(np.rint(depth * unit).astype(np.uint16)).save(depth_path)


def pose(index: int) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.1 * index, 0.0, 0.2]).as_matrix()
    T[:3, 3] = [0.1 * index, 0.0, 1.0]
    return T


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """Eight frames in 7-Scenes' layout."""
    for i in range(8):
        stem = tmp_path / f"frame-{i:06d}"
        save(*images(i), Path(f"{stem}.color.png"), Path(f"{stem}.depth.png"), 1000.0)
        np.savetxt(f"{stem}.pose.txt", pose(i), fmt="%.4f")
    np.savetxt(tmp_path / "camera-intrinsics.txt", [[30.0, 0, 15.5], [0, 31.0, 11.5], [0, 0, 1]])
    return tmp_path


def tum(folder: Path) -> Path:
    """Eight frames in TUM's layout: depth 5 ms after colour, ground truth at 100 Hz, one colour picture alone."""
    folder.mkdir()
    (folder / "rgb").mkdir()
    (folder / "depth").mkdir()
    colors, depth_lines, truth = (
        ["# timestamp filename"],
        ["# timestamp filename"],
        ["# timestamp tx ty tz qx qy qz qw"],
    )
    for i in range(8):
        t = 100.0 + i / 30
        save(*images(i), folder / f"rgb/{t:.6f}.png", folder / f"depth/{t + 0.005:.6f}.png", 5000.0)
        colors.append(f"{t:.6f} rgb/{t:.6f}.png")
        depth_lines.append(f"{t + 0.005:.6f} depth/{t + 0.005:.6f}.png")
        quaternion = Rotation.from_matrix(pose(i)[:3, :3]).as_quat()
        truth.append(f"{t + 0.001:.6f} " + " ".join(f"{x:.6f}" for x in [*pose(i)[:3, 3], *quaternion]))
    colors.append("200.0 rgb/none.png")
    for name, lines in (("rgb", colors), ("depth", depth_lines), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return folder


def check(camera: DatasetCamera, count: int = 8) -> None:
    frames = list(camera)
    assert len(frames) == count == camera.report.good
    for i, frame in enumerate(frames):
        rgb, depth = images(i)
        np.testing.assert_array_equal(frame.rgb, rgb)
        np.testing.assert_allclose(frame.depth, depth, atol=6e-4)
        assert frame.depth.dtype == np.float32 and frame.intrinsics is camera.intrinsics
    assert np.allclose(np.diff([frame.stamp for frame in frames]), 1 / 30, atol=1e-5)
    assert camera.read() is None


def test_seven_scenes_is_recognised(scenes):
    with open_camera(scenes) as camera:
        assert camera.layout == "7-Scenes" and camera.intrinsics == (W, H, 30.0, 31.0, 15.5, 11.5, None, None)
        check(camera)
        assert not camera.report.bad and not camera.report.gaps and str(camera.report) == "8 frames"
    frame = next(iter(DatasetCamera(scenes, start=3)))
    np.testing.assert_allclose(frame.T_world_camera, pose(3), atol=1e-3)
    assert len(list(DatasetCamera(scenes, start=1, stop=7, step=2))) == 3


def test_seven_scenes_own_camera_is_known(scenes):
    (scenes / "camera-intrinsics.txt").unlink()
    assert open_camera(scenes).intrinsics[2:6] == (585.0, 585.0, 320.0, 240.0)


def test_tum_is_recognised_and_associated(tmp_path):
    folder = tum(tmp_path / "rgbd_dataset_freiburg2_desk")
    camera = open_camera({"backend": "dataset", "path": str(folder)})
    assert camera.layout == "TUM" and camera.intrinsics[2:6] == (520.9, 521.0, 325.1, 249.7)
    assert camera.report.unmatched == 1
    np.testing.assert_allclose(next(iter(DatasetCamera(folder, start=5))).T_world_camera, pose(5), atol=1e-5)
    check(camera)
    with pytest.raises(ValueError, match=r"no picture .* within 0\.001 s"):
        DatasetCamera(folder, max_gap=0.001)


@pytest.mark.parametrize("names", ["folders", "pairs"])
def test_folders_and_pairs_are_recognised_and_ten_comes_after_nine(tmp_path, names):
    if names == "folders":
        (tmp_path / "rgb").mkdir()
        (tmp_path / "depth").mkdir()
    for i in range(4, 12):
        color, depth = (f"rgb/{i}.png", f"depth/{i}.png") if names == "folders" else (f"{i}.png", f"{i}_depth.png")
        save(*images(i - 4), tmp_path / color, tmp_path / depth, 1000.0 if names == "folders" else 5000.0)
    with pytest.raises(ValueError, match="intrinsics missing"):
        open_camera(tmp_path)
    camera = DatasetCamera(tmp_path, INTRINSICS)
    assert camera.layout == names
    check(camera)


def test_bad_frames_are_counted_and_the_rest_goes_on(scenes):
    part = (scenes / "frame-000001.depth.png").read_bytes()
    (scenes / "frame-000001.depth.png").write_bytes(part[: len(part) // 2])  # truncated
    (scenes / "frame-000002.color.png").write_bytes(b"no picture")
    Image.fromarray(images(3)[0]).resize((W // 2, H)).save(scenes / "frame-000003.color.png")  # another size
    Image.fromarray(images(4)[0][..., 0]).save(scenes / "frame-000004.depth.png")  # eight bits
    (scenes / "frame-000005.pose.txt").write_text("1 0 0 0\n")
    np.savetxt(scenes / "frame-000006.pose.txt", 2.0 * np.eye(4))
    camera = open_camera(scenes)
    assert [frame.rgb[0, 0, 0] for frame in camera] == [0, 70]
    faults = dict(camera.report.bad)
    expected = {
        1: r"depth.png: expected a whole picture",
        2: r"color.png: expected a whole picture",
        3: r"color.png: expected 32×24 pixels, got 16×24",
        4: r"depth.png: expected a depth picture of 16 bits a pixel, got mode L",
        5: r"pose.txt: expected 4×4 finite numbers, got 4",
        6: r"pose.txt: expected a rigid transform",
    }
    for index, words in expected.items():
        assert words in faults[f"frame-{index:06d}.color.png"]
    assert "2 frames" in str(camera.report) and "6 bad ones left out" in str(camera.report)


def test_gaps_in_the_stamps_are_reported(scenes):
    for i in (3, 4, 5):
        (scenes / f"frame-{i:06d}.color.png").unlink()
    camera = open_camera(scenes)
    assert len(list(camera)) == 5
    ((before, after),) = camera.report.gaps
    assert (before, after) == pytest.approx((2 / 30, 6 / 30))
    assert "1 gaps in the time stamps, up to 0.133 s" in str(camera.report)
    assert camera.report.unmatched == 3


def test_what_cannot_be_a_sequence_is_one_clear_error(scenes, tmp_path):
    for unit in (1.0, 1e6):
        with pytest.raises(ValueError, match=r"expected depths in steps of .* median .* set the unit by depth_unit"):
            DatasetCamera(scenes, depth_unit=unit)
    with pytest.raises(ValueError, match=r"32×24, got 64×24"):
        DatasetCamera(scenes, {**INTRINSICS, "width": 64})
    with pytest.raises(ValueError, match="fy, cy missing"):
        DatasetCamera(scenes, {k: v for k, v in INTRINSICS.items() if k not in ("fy", "cy")})
    with pytest.raises(ValueError, match="has 8 frames"):
        DatasetCamera(scenes, start=9)
    with pytest.raises(ValueError, match="depth_unit"):
        DatasetCamera(scenes, depth_unit=-1.0)
    for path in scenes.glob("*.color.png"):
        path.write_bytes(b"")
    with pytest.raises(ValueError, match="none of the first 10 frames can be read"):
        open_camera(scenes)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ValueError, match=r"7-Scenes.*folders color"):
        open_camera(empty)
    with pytest.raises(FileNotFoundError, match="no such"):
        open_camera(tmp_path / "nothing")
    with pytest.raises(FileNotFoundError, match="no such folder"):
        open_camera({"backend": "dataset", "path": str(tmp_path / "nothing")})
    folder = tum(tmp_path / "tum")
    (folder / "rgb.txt").write_text("1.0 a.png\nnow b.png\n")
    with pytest.raises(ValueError, match=r"rgb.txt, line 2"):
        open_camera(folder)


def test_one_file_chooses_the_camera(scenes, tmp_path):
    file = scenes.parent / "camera.toml"
    file.write_text(f'backend = "dataset"\npath = "{scenes.name}"\nstop = 2\n')
    assert len(list(open_camera(file))) == 2
    file = scenes.parent / "camera.json"
    file.write_text(json.dumps({"backend": "dataset", "path": scenes.name, "intrinsics": INTRINSICS}))
    assert open_camera(str(file)).intrinsics.fx == 30.0
    file.write_text("{")
    with pytest.raises(ValueError, match=r"camera.json: expected JSON"):
        open_camera(file)
    for config, words in (
        ({"path": "x"}, "backend: missing"),
        ({"backend": "realsens"}, "did you mean 'realsense'"),
        ({"backend": "dataset", "pth": "x"}, "pth: unknown.*did you mean 'path'"),
        ({"backend": "dataset"}, "path"),
        ({"backend": "uvc", "intrinsics": 3}, "intrinsics: expected a table"),
        ({"backend": "uvc", "intrinsics": {**INTRINSICS, "fx": "30"}}, "fx: expected a number"),
        ({"backend": "uvc", "intrinsics": {**INTRINSICS, "skew": 0}}, "unknown entry 'skew'"),
        ({"backend": "kinect", "resolution": 5}, "resolution"),
        (3, "config"),
    ):
        with pytest.raises(ValueError, match=words):
            open_camera(config)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("config", "package"),
    [({"backend": "realsense"}, "pyrealsense2"), ({"backend": "kinect"}, "pyk4a"), ({"backend": "zed"}, "pyzed"),
     ({"backend": "ros2"}, "rclpy"), ({"backend": "rosbag", "path": "."}, "rosbags")],
)  # fmt: skip
def test_an_absent_package_is_named(monkeypatch, config, package):
    for name in (package, "pyzed.sl", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingPackage, match=f"{config['backend']}.*{package}") as caught:
        open_camera(config)
    assert "\n" not in str(caught.value)


def test_a_camera_that_is_not_there_is_one_clear_error():
    with pytest.raises(CameraError, match="does not open"):
        open_camera({"backend": "uvc", "device": "/nowhere/video", "intrinsics": INTRINSICS})


def test_a_video_is_a_camera(tmp_path):
    import cv2

    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48))
    for i in range(5):
        writer.write(np.full((48, 64, 3), (200, 50, 40 * i), np.uint8))  # BGR
    writer.release()
    config = {"backend": "uvc", "device": str(path), "intrinsics": {**INTRINSICS, "width": 64, "height": 48}}
    with open_camera(config) as camera:
        frames = list(camera)
    assert len(frames) == 5 and frames[4].stamp == pytest.approx(4 / 30)
    np.testing.assert_allclose(frames[4].rgb.mean(axis=(0, 1)), (160, 50, 200), atol=8)
    assert not frames[0].depth.any()
    with pytest.raises(CameraError, match="expected pictures of 32×24, got 64×48"):
        open_camera({**config, "intrinsics": INTRINSICS}).read()


# --- devices, with modules that answer as the makers' do --------------------------------------------------------------


def fake_realsense(answers: int) -> ModuleType:
    color, depth = images(2)
    state = SimpleNamespace(left=answers, stopped=0)
    intrinsics = SimpleNamespace(fx=30.0, fy=31.0, ppx=15.5, ppy=11.5, coeffs=[0.1, 0.0, 0.0, 0.0, 0.0])
    stream = SimpleNamespace(as_video_stream_profile=lambda: SimpleNamespace(get_intrinsics=lambda: intrinsics))
    sensor = SimpleNamespace(get_depth_scale=lambda: 0.001)
    device = SimpleNamespace(first_depth_sensor=lambda: sensor)
    profile = SimpleNamespace(get_device=lambda: device, get_stream=lambda _: stream)

    class Pipeline:
        def start(self, setup):
            return profile

        def wait_for_frames(self):
            state.left -= 1
            if state.left < 0:
                raise RuntimeError("Frame didn't arrive within 5000")
            return SimpleNamespace(
                get_color_frame=lambda: SimpleNamespace(get_data=lambda: color, get_timestamp=lambda: 2500.0),
                get_depth_frame=lambda: SimpleNamespace(get_data=lambda: np.rint(depth * 1000).astype(np.uint16)),
            )

        def stop(self):
            state.stopped += 1

    module = ModuleType("pyrealsense2")
    config = SimpleNamespace(enable_device=lambda _: None, enable_stream=lambda *_: None)
    module.__dict__.update(
        pipeline=Pipeline,
        config=lambda: config,
        align=lambda _: SimpleNamespace(process=lambda frames: frames),
        stream=SimpleNamespace(color=1, depth=2),
        format=SimpleNamespace(rgb8=1, z16=2),
        state=state,
    )
    return module


def test_realsense_frames_and_their_end(monkeypatch):
    module = fake_realsense(answers=2)
    monkeypatch.setitem(sys.modules, "pyrealsense2", module)
    camera = open_camera({"backend": "realsense", "width": W, "height": H})
    rgb, depth = images(2)
    for _ in range(2):
        frame = camera.read()
        np.testing.assert_array_equal(frame.rgb, rgb)
        np.testing.assert_allclose(frame.depth, depth, atol=1e-6)
        assert frame.stamp == 2.5 and frame.intrinsics.distortion[0] == 0.1
    with pytest.raises(CameraError, match="gives no more frames"):
        camera.read()
    assert camera.report.good == 2 and len(camera.report.bad) == 5
    camera.close()
    camera.close()
    assert module.__dict__["state"].stopped == 1
    with pytest.raises(CameraError, match="closed"):
        camera.read()


# --- ROS --------------------------------------------------------------------------------------------------------------


def message(array: np.ndarray, encoding: str, stamp: float = 0.0, pad: int = 0) -> SimpleNamespace:
    """A sensor_msgs/Image, its rows padded by `pad` bytes."""
    rows = np.ascontiguousarray(array).view(np.uint8).reshape(array.shape[0], -1)
    rows = np.pad(rows, ((0, 0), (0, pad)))
    seconds = int(stamp)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=round((stamp - seconds) * 1e9)))
    return SimpleNamespace(
        **{"header": header, "height": array.shape[0], "width": array.shape[1], "encoding": encoding},
        **{"is_bigendian": array.dtype.byteorder == ">", "step": rows.shape[1], "data": rows.tobytes()},
    )


def test_pictures_of_ros_in_their_encodings():
    rgb = np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8)
    alpha = np.dstack([rgb, np.full((H, W), 255, np.uint8)])
    for array, encoding in (
        (rgb, "rgb8"),
        (rgb[..., ::-1], "bgr8"),
        (alpha, "rgba8"),
        (alpha[..., [2, 1, 0, 3]], "bgra8"),
    ):
        np.testing.assert_array_equal(picture(message(array, encoding, pad=5)), rgb)
    gray = picture(message(rgb[..., 0], "mono8"))
    assert (gray == rgb[..., :1]).all()
    with pytest.raises(ValueError, match="got 'yuv422'"):
        picture(message(rgb, "yuv422"))
    short = message(rgb, "rgb8")
    short.data = short.data[:-10]
    with pytest.raises(ValueError, match="expected 24 rows of at least 96 bytes"):
        picture(short)


def test_depths_of_ros_in_their_encodings():
    depth = np.random.default_rng(0).uniform(0.5, 4.0, (H, W)).astype(np.float32)
    millimetres = np.rint(1000 * depth).astype(np.uint16)
    for array in (millimetres, millimetres.astype(">u2")):
        np.testing.assert_allclose(depths(message(array, "16UC1", pad=3)), depth, atol=6e-4)
    hole = depth.copy()
    hole[0, :3] = np.nan, np.inf, -1.0
    seen = depths(message(hole, "32FC1"))
    np.testing.assert_array_equal(seen[0, :3], 0.0)
    np.testing.assert_array_equal(seen[1:], depth[1:])
    with pytest.raises(ValueError, match="got 'rgb8'"):
        depths(message(millimetres, "rgb8"))


def test_intrinsics_of_ros():
    K = [30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1]
    for names in (("k", "d"), ("K", "D")):
        info = SimpleNamespace(**{"width": W, "height": H, names[0]: K, names[1]: [0.0] * 5})
        assert camera_info(info) == (W, H, 30.0, 31.0, 15.5, 11.5, None, None)


def test_partners_are_the_nearest_in_time_and_the_rest_is_counted():
    partners, pairs = Partners(0.02), []
    stream = [(0, 1.00), (1, 1.005), (0, 1.033), (0, 1.066), (1, 1.070), (1, 1.101), (0, 1.100), (1, 1.5), (0, 1.6)]
    for which, stamp in stream:
        pair = partners.add(which, message(np.zeros((1, 1), np.uint8), "mono8", stamp))
        if pair is not None:
            pairs.append(tuple(round(p.header.stamp.sec + 1e-9 * p.header.stamp.nanosec, 3) for p in pair))
    assert pairs == [(1.0, 1.005), (1.066, 1.07), (1.1, 1.101)]
    assert partners.unmatched == 1  # 1.033; 1.5 and 1.6 still wait
    with pytest.raises(ValueError, match="max_gap"):
        Partners(0.0)


def test_a_bag_is_a_camera(tmp_path):
    """Written and read with rosbags, where it is installed."""
    writing = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    types = store.types
    path = tmp_path / "bag"

    def header(stamp: float):
        time = types["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round((stamp % 1) * 1e9))
        return types["std_msgs/msg/Header"](stamp=time, frame_id="camera")

    def image(array, encoding, stamp):
        data = np.ascontiguousarray(array).view(np.uint8).ravel()
        return types["sensor_msgs/msg/Image"](
            *(header(stamp), array.shape[0], array.shape[1], encoding, 0, len(data) // array.shape[0], data)
        )

    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = types["sensor_msgs/msg/CameraInfo"](
        *(header(0.0), H, W, "plumb_bob", np.zeros(5), np.array([30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1])),
        *(np.eye(3).ravel(), np.zeros(12), 0, 0, roi),
    )
    with writing.Writer(path, version=9) as writer:
        topics = {}
        for topic, kind in (("c", "Image"), ("d", "Image"), ("i", "CameraInfo")):
            topics[topic] = writer.add_connection(f"/{topic}", f"sensor_msgs/msg/{kind}", typestore=store)
        writer.write(topics["i"], 0, store.serialize_cdr(info, "sensor_msgs/msg/CameraInfo"))
        for i in range(4):
            rgb, depth = images(i)
            stamp = 1.0 + i / 30
            for topic, one in (
                ("c", image(rgb, "rgb8", stamp)),
                ("d", image(depth.astype(np.float32), "32FC1", stamp + 0.004)),
            ):
                writer.write(topics[topic], int(1e9 * stamp), store.serialize_cdr(one, "sensor_msgs/msg/Image"))
    config = {"backend": "rosbag", "path": path, "color": "/c", "depth": "/d", "info": "/i"}
    with open_camera(config) as camera:
        frames = list(camera)
        assert camera.intrinsics == (W, H, 30.0, 31.0, 15.5, 11.5, None, None)
    assert len(frames) == 4 and frames[3].stamp == pytest.approx(1.1)
    np.testing.assert_array_equal(frames[2].rgb, images(2)[0])
    np.testing.assert_allclose(frames[2].depth, images(2)[1], rtol=1e-6)
    with pytest.raises(ValueError, match=r"no topic '/x'; it has /c, /d, /i"):
        open_camera({**config, "color": "/x"})
    with pytest.raises(ValueError, match="expected a ROS bag"):
        open_camera({**config, "path": tmp_path})


# --- real data --------------------------------------------------------------------------------------------------------


@needs_data
def test_recorded_seven_scenes():
    camera = open_camera({"backend": "dataset", "path": str(DATA / "rgbd_7scenes"), "stop": 12})
    frames = list(camera)
    assert camera.layout == "7-Scenes" and len(frames) == 12 and not camera.report.bad and not camera.report.gaps
    assert camera.intrinsics[:6] == (640, 480, 585.0, 585.0, 320.0, 240.0)
    poses = np.array([frame.T_world_camera for frame in frames])
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].swapaxes(1, 2), np.eye(3)[None].repeat(12, 0), atol=1e-9
    )
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.05  # neighbouring frames stand together
    seen = frames[0].depth > 0
    assert 0.5 < seen.mean() < 1.0 and 1.0 < np.median(frames[0].depth[seen]) < 3.0


@needs_data
def test_recorded_pair_of_tum():
    camera = open_camera(
        {"backend": "dataset", "path": str(DATA / "rgbd_tum_pair"),
         "intrinsics": {"width": 640, "height": 480, "fx": 520.9, "fy": 521.0, "cx": 325.1, "cy": 249.7}}
    )  # fmt: skip
    frames = list(camera)
    assert camera.layout == "pairs" and len(frames) == 2
    assert 1.0 < np.median(frames[0].depth[frames[0].depth > 0]) < 2.0  # 1.5 m, in steps of 1/5000 m
