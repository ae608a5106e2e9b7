"""Every reader of files that users bring, with good small files for it."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from hypothesis import strategies as st

from tests.fuzzing.mutations import damaged_arrays, damaged_bytes, damaged_json, damaged_text
from torchhand.evaluate import load_truth
from torchhand.export import (
    MotionClip,
    clip_of_bap,
    clip_of_bvh,
    clip_of_mano,
    clip_of_openxr,
    clip_of_stream,
    load_clip,
    write_bap,
    write_bvh,
    write_mano,
    write_openxr,
    write_stream,
)
from torchhand.files import (
    FrameRecord,
    TrackHeader,
    TrackWriter,
    camera_per_picture,
    load_cameras,
    load_hand,
    load_hand_model,
    load_mesh,
    load_proposal_network,
    load_rig,
    load_track,
    models_dir,
    open_source,
    read_detections,
    read_picture,
    save_cameras,
    save_detections,
    save_hand,
)
from torchhand.files.detections import read_rig_detections
from torchhand.files.hands import read_shape_space, read_skeleton
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import DOFS
from torchhand.runs import settings_of
from torchhand.signs import load_signs
from torchhand.simulate import read_glove

Damage = Callable[[bytes], st.SearchStrategy[bytes]]


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One kind of file."""

    file: str
    """The file that is damaged."""
    make: Callable[[Path], Any]
    """Writes good files into a folder."""
    read: Callable[[Path], Any]
    """Reads them from a folder."""
    damages: tuple[Damage, ...] = (damaged_bytes,)

    def damaged(self) -> st.SearchStrategy[bytes]:
        """The content of the file with something wrong in it."""
        data = good_files(self)[self.file]
        return st.one_of(*(damage(data) for damage in self.damages))


@cache
def good_files(reader: Reader) -> dict[str, bytes]:
    """Content of the good files by name."""
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        reader.make(folder)
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# ---------------------------------------------------------------------------------------- pictures and videos


def _image(seed: int = 0, dtype: type = np.uint8) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (24, 32, 3)).astype(dtype)
    return cv2.GaussianBlur(noise, (0, 0), 2)


def _video(codec: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        name = "clip.mp4" if codec == "mp4v" else "clip.avi"
        writer = cv2.VideoWriter(str(folder / name), cv2.VideoWriter.fourcc(*codec), 25.0, (64, 48))
        for i in range(6):
            writer.write(cv2.resize(_image(i), (64, 48)))
        writer.release()

    return make


def _frames(name: str) -> Callable[[Path], int]:
    def read(folder: Path) -> int:
        with open_source(folder / name) as source:
            return sum(frame.image is not None for frame in source)

    return read


def _picture(suffix: str, dtype: type = np.uint8) -> Reader:
    name = f"a.{suffix}"
    return Reader(
        file=name,
        make=lambda folder: cv2.imwrite(str(folder / name), _image(dtype=dtype)),
        read=lambda folder: read_picture(folder / name),
    )


def _pictures(folder: Path) -> None:
    (folder / "frames").mkdir()
    for i in range(3):
        cv2.imwrite(str(folder / "frames" / f"{i}.png"), _image(i))


# ---------------------------------------------------------------------------------------- cameras


def cameras() -> list[Camera]:
    """Three that see one place."""
    turns = ((0.0, 0.0, 0.0), (0.1, 0.7, 0.05), (-0.8, 0.1, 0.0))
    return [
        Camera(
            intrinsics=torch.tensor([[600.0 + i, 0, 318.5], [0, 598.0, 241.25], [0, 0, 1]], dtype=torch.float64),
            rotation=rotation_from_vector(torch.tensor(turn, dtype=torch.float64)),
            translation=torch.tensor((0.01 * i, -0.02, 0.5), dtype=torch.float64),
            distortion=torch.tensor([-0.1, 0.02, 0.001, -0.002], dtype=torch.float64),
            width=640,
            height=480,
            name=f"cam{i}",
        )
        for i, turn in enumerate(turns)
    ]


def _opencv(suffix: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        for camera in cameras():
            file = cv2.FileStorage(str(folder / f"{camera.name}.{suffix}"), cv2.FileStorage_WRITE)
            file.write("image_width", 640)
            file.write("image_height", 480)
            file.write("camera_matrix", camera.intrinsics.numpy())
            file.write("distortion_coefficients", camera.distortion.numpy()[None])
            file.write("R", camera.rotation.numpy())
            file.write("T", camera.translation.numpy()[:, None])
            file.release()

    return make


def _toml(folder: Path) -> None:
    tables = [
        f'[cam_{i}]\nname = "{camera.name}"\nsize = [640, 480]\nmatrix = {camera.intrinsics.tolist()}\n'
        f"distortions = {camera.distortion.tolist()}\nrotation = [0.0, {0.3 * i}, 0.0]\n"
        f"translation = {camera.translation.tolist()}\n"
        for i, camera in enumerate(cameras())
    ]
    (folder / "calibration.toml").write_text("\n".join(tables) + "\n[metadata]\nadjusted = false\n")


def _colmap(folder: Path) -> None:
    lenses = [f"{i + 1} OPENCV 640 480 {600 + i} 598 319 241.75 -0.1 0.02 0.001 -0.002" for i in range(3)]
    (folder / "cameras.txt").write_text("# Camera list\n" + "\n".join(lenses) + "\n")
    turns = ((1.0, 0.0), (0.995, 0.0998749), (0.98, 0.1989975))
    rows = [f"{i + 1} {w} 0 {y} 0 0.01 -0.02 0.5 {i + 1} cam{i}.jpg\n10.5 20.5 -1" for i, (w, y) in enumerate(turns)]
    (folder / "images.txt").write_text("# Image list\n" + "\n".join(rows) + "\n")


def _plain_text(folder: Path) -> None:
    for i, camera in enumerate(cameras()):
        rows = "\n".join(" ".join(map(repr, row)) for row in camera.intrinsics.tolist())
        (folder / f"c{i}.dat").write_text(f"intrinsic:\n{rows}\ndistortion:\n-0.1 0.02 0.001 -0.002\n")
        rows = "\n".join(" ".join(map(repr, row)) for row in camera.rotation.tolist())
        shift = "\n".join(map(repr, camera.translation.tolist()))
        (folder / f"rot_trans_c{i}.dat").write_text(f"R:\n{rows}\nT:\n{shift}\n")


def _rig(file: str, make: Callable[[Path], Any], *damages: Damage) -> Reader:
    return Reader(
        file=file,
        make=make,
        read=lambda folder: load_rig(folder, size=(640, 480)),
        damages=damages or (damaged_bytes, damaged_text),
    )


def _intrinsics(folder: Path) -> None:
    np.savez(folder / "K.npz", K=np.tile(np.diag((500.0, 500.0, 1.0)), (3, 1, 1)), image=np.array(["a", "b", "c"]))


# ---------------------------------------------------------------------------------------- keypoints


def _points(frames: int, dimension: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.1, 0.9, (frames, 21, dimension))


def _mediapipe(folder: Path) -> None:
    def listed(points: np.ndarray) -> list[dict[str, float]]:
        return [dict(zip("xyz", row.tolist(), strict=True)) for row in points]

    frames = [
        {
            "frame": i,
            "multi_hand_landmarks": [{"landmark": listed(image)}],
            "multi_hand_world_landmarks": [{"landmark": listed(0.1 * image)}],
            "multi_handedness": [{"classification": [{"index": 0, "score": 0.98, "label": "Left"}]}],
        }
        for i, image in enumerate(_points(2, 3))
    ]
    (folder / "hands.json").write_text(json.dumps(frames))


def _openpose(folder: Path) -> None:
    (folder / "hands").mkdir()
    for i, points in enumerate(_points(3, 3)):
        person = {"person_id": [-1], "hand_right_keypoints_2d": (300 * points).reshape(-1).tolist()}
        (folder / "hands" / f"clip_{i:012d}_keypoints.json").write_text(
            json.dumps({"version": 1.3, "people": [person]})
        )


def _detected(folder: Path) -> None:
    label, score = np.array(["Left", "", "Left"]), np.array([0.9, np.nan, 0.8])
    points = {"points_px": 300 * _points(3, 2), "world": 0.1 * _points(3, 3)}
    np.savez(folder / "hands.npz", **points, label=label, score=score, image=np.array(["a", "b", "c"]))


def _log(folder: Path) -> None:
    rows = [
        {"view": 0, "frame": i, "label": "Left", "score": 0.9, "points_px": px.tolist(), "world": px.tolist()}
        for i, px in enumerate(_points(3, 3))
    ]
    for row in rows:
        row["points_px"] = [point[:2] for point in row["points_px"]]
    (folder / "keypoints.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def _keypoints(file: str, make: Callable[[Path], Any], *damages: Damage, folder: str = "") -> Reader:
    return Reader(
        file=file, make=make, read=lambda place: read_detections(place / (folder or file)).keypoints, damages=damages
    )


# ---------------------------------------------------------------------------------------- results


def _hand(folder: Path) -> None:
    space = load_hand_model().shape_space
    save_hand(folder / "hand.json", space.names, space.default.tolist(), "right", {"a": 1}, units=space.units)


def _track(folder: Path, *, stops: bool = False) -> None:
    _hand(folder)
    header = TrackHeader(dof_names=DOFS, source="a.mp4", side="right", camera={"name": "cam0", "width": 640})
    rest = load_hand_model().kinematics(dtype=torch.float64)
    pose = torch.zeros(36, dtype=torch.float64)
    pose[2] = 0.5
    points = rest(pose, load_hand_model().shape_space.default).keypoints.numpy()
    record = {
        "status": "tracked",
        "pose": pose.numpy(),
        "pose_std": np.full(36, 0.1),
        "keypoints3d": points,
        "keypoints2d": 300 * points[:, :2],
        "keypoints3d_cov": np.tile(1e-6 * np.eye(3), (21, 1, 1)),
        "seconds": 0.1,
    }
    with TrackWriter(folder, header, resume=True, keep_checkpoint=True) as writer:
        for frame in range(3):
            writer.append(FrameRecord(frame=frame, **record), lambda: {"state": torch.zeros(3)})
    if stops:
        (folder / "track.npz").unlink()


def _go_on(folder: Path) -> str | None:
    header = TrackHeader(dof_names=DOFS, source="a.mp4", side="right", camera={"name": "cam0", "width": 640})
    with TrackWriter(folder, header, resume=True) as writer:
        return writer.note


def _replacement(folder: Path) -> None:
    _track(folder)
    (folder / "unfinished").mkdir()
    marker = {"kept": ["hand.json", "track.npz"], "dropped": ["overlay.mp4", "overlays"]}
    (folder / "unfinished" / "complete.json").write_text(json.dumps(marker) + "\n")


# ---------------------------------------------------------------------------------------- motion


@cache
def _clip() -> MotionClip:
    model = load_hand_model()
    poses = torch.zeros(4, 36, dtype=torch.float64)
    poses[:, 2], poses[:, 3], poses[:, 8:] = 0.5, torch.linspace(0, 1, 4), torch.linspace(0, 0.2, 4)[:, None]
    return MotionClip(model=model, side="right", shape=model.shape_space.default, poses=poses, fps=25.0, name="a")


def _motion(file: str, write: Callable[..., Any], read: Callable[..., Any], *damages: Damage) -> Reader:
    return Reader(
        file=file,
        make=lambda folder: write(_clip(), folder / file),
        read=lambda folder: read(folder / file, load_hand_model()),
        damages=damages,
    )


def _glove(folder: Path) -> None:
    rows = [[2009, 11, 20, 10, 5, 0.5 + i / 60, 0, *np.linspace(-1, 0.3, 23)] for i in range(5)]
    (folder / "glove.txt").write_text("\n".join(" ".join(f"{value:.4f}" for value in row) for row in rows))


def _truth(folder: Path) -> None:
    np.savez(
        folder / "truth.npz",
        keypoints3d=0.1 * _points(3, 3),
        keypoints2d=300 * _points(3, 2),
        flexion_deg=np.full((3, 5, 3), 20.0),
    )


# ---------------------------------------------------------------------------------------- models and settings


def _shipped(*parts: str) -> Callable[[Path], Any]:
    path = models_dir().joinpath(*parts)
    return lambda folder: (folder / path.name).write_bytes(path.read_bytes())


def _names() -> Sequence[str]:
    return load_hand_model().shape_space.names


def _config(folder: Path) -> None:
    (folder / "my.yaml").write_text(
        "method: contour\nposture: open\nlearned_posture: false\nnoise: {rotation: 80, translation: 1.5}\n"
        "update:\n  gate: 9.0 # of a chi-squared\n  passes: 2\nsilhouette: {method: skin}\n"
    )


def _change(folder: Path) -> None:
    (folder / "change").write_text("noise.rotation=80.5")


_JSON, _ARRAYS, _TEXT = (damaged_bytes, damaged_json), (damaged_bytes, damaged_arrays), (damaged_bytes, damaged_text)

READERS: dict[str, Reader] = {
    "mp4": Reader(file="clip.mp4", make=_video("mp4v"), read=_frames("clip.mp4")),
    "avi": Reader(file="clip.avi", make=_video("MJPG"), read=_frames("clip.avi")),
    **{suffix: _picture(suffix) for suffix in ("jpg", "png", "bmp", "tiff", "webp", "ppm")},
    "deep png": _picture("png", np.uint16),
    "deep tiff": _picture("tiff", np.uint16),
    "folder of pictures": Reader(file="frames/1.png", make=_pictures, read=_frames("frames")),
    "cameras.json": Reader(
        file="cameras.json",
        make=lambda folder: save_cameras(cameras(), folder / "cameras.json"),
        read=lambda folder: load_cameras(folder / "cameras.json"),
        damages=_JSON,
    ),
    "rig.json": _rig("cameras.json", lambda folder: save_cameras(cameras(), folder / "cameras.json"), *_JSON),
    "opencv yaml": _rig("cam1.yml", _opencv("yml")),
    "opencv xml": _rig("cam1.xml", _opencv("xml")),
    "aniposelib": _rig("calibration.toml", _toml),
    "colmap cameras": _rig("cameras.txt", _colmap),
    "colmap images": _rig("images.txt", _colmap),
    "plain text lens": _rig("c1.dat", _plain_text),
    "plain text place": _rig("rot_trans_c1.dat", _plain_text),
    "intrinsics": Reader(
        file="K.npz",
        make=_intrinsics,
        read=lambda folder: camera_per_picture(folder / "K.npz", ("a", "b", "c"), 3),
        damages=_ARRAYS,
    ),
    "mediapipe": _keypoints("hands.json", _mediapipe, *_JSON),
    "openpose": _keypoints("hands/clip_000000000001_keypoints.json", _openpose, *_JSON, folder="hands"),
    "keypoint arrays": _keypoints("hands.npz", _detected, *_ARRAYS),
    "keypoint array": _keypoints("hands.npy", lambda folder: np.save(folder / "hands.npy", _points(3, 3)), *_ARRAYS),
    "keypoints of a rig": Reader(
        file="hands.npy",
        make=lambda folder: np.save(folder / "hands.npy", 300 * np.stack([_points(3, 2)] * 2)),
        read=lambda folder: read_rig_detections(folder / "hands.npy"),
        damages=_ARRAYS,
    ),
    "detections of a run": Reader(
        file="keypoints.jsonl",
        make=_log,
        read=lambda folder: save_detections(folder / "keypoints.jsonl", folder, 1),
        damages=_JSON,
    ),
    "hand.json": Reader(
        file="hand.json", make=_hand, read=lambda folder: load_hand(folder / "hand.json", _names()), damages=_JSON
    ),
    "track.npz": Reader(file="track.npz", make=_track, read=load_track, damages=_ARRAYS),
    "track.jsonl": Reader(
        file="track.jsonl", make=lambda folder: _track(folder, stops=True), read=load_track, damages=_JSON
    ),
    "clip of a track": Reader(
        file="track.npz",
        make=_track,
        read=load_clip,
        damages=(damaged_arrays,),
    ),
    "run to resume": Reader(
        file="track.jsonl", make=lambda folder: _track(folder, stops=True), read=_go_on, damages=_JSON
    ),
    "checkpoint": Reader(file="checkpoint.pt", make=_track, read=_go_on),
    "replacement": Reader(
        file="unfinished/complete.json", make=_replacement, read=load_track, damages=(damaged_json, damaged_bytes)
    ),
    "thp": _motion("a.thp", write_stream, clip_of_stream, damaged_bytes),
    "bvh": _motion("a.bvh", write_bvh, clip_of_bvh, *_TEXT),
    "bap": _motion("a.bap", write_bap, clip_of_bap, *_TEXT),
    "mano": _motion("a.npz", write_mano, clip_of_mano, *_ARRAYS),
    "openxr": _motion("a.json", write_openxr, clip_of_openxr, *_JSON),
    "glove": Reader(file="glove.txt", make=_glove, read=lambda folder: read_glove(folder / "glove.txt"), damages=_TEXT),
    "truth": Reader(file="truth.npz", make=_truth, read=load_truth, damages=_ARRAYS),
    "urdf": Reader(
        file="hand.urdf",
        make=_shipped("generic_hand", "hand.urdf"),
        read=lambda folder: read_skeleton(folder / "hand.urdf"),
        damages=_TEXT,
    ),
    "shape space": Reader(
        file="shape.json",
        make=_shipped("generic_hand", "shape.json"),
        read=lambda folder: read_shape_space(folder / "shape.json"),
        damages=_JSON,
    ),
    "signs": Reader(
        file="signs.json",
        make=_shipped("generic_hand", "signs.json"),
        read=lambda folder: load_signs(folder / "signs.json"),
        damages=_JSON,
    ),
    "mesh": Reader(
        file="mesh.npz",
        make=_shipped("generic_hand", "mesh.npz"),
        read=lambda folder: load_mesh(folder / "mesh.npz", shape_names=_names()),
        damages=_ARRAYS,
    ),
    "network": Reader(
        file="network.npz",
        make=_shipped("proposals", "network.npz"),
        read=lambda folder: load_proposal_network(folder / "network.npz"),
        damages=_ARRAYS,
    ),
    "configuration": Reader(
        file="my.yaml", make=_config, read=lambda folder: settings_of(str(folder / "my.yaml")), damages=_TEXT
    ),
    "--set": Reader(
        file="change",
        make=_change,
        read=lambda folder: settings_of("contour_full", [(folder / "change").read_bytes().decode("utf-8", "replace")]),
        damages=_TEXT,
    ),
}
