"""Named rigs stand where the paper says, and a hand's stage is where cameras look."""

import math
from dataclasses import replace

import pytest
import torch

from torchhand.errors import InputError
from torchhand.geometry import Camera, assumed_camera, centres_world, meeting_point, sees
from torchhand.simulate.motion import filling_distance
from torchhand.simulate.rigs.rigs import DISTANCE, named_rig
from torchhand.simulate.rigs.stage import stage_camera

ORIGIN = torch.zeros(1, 3, dtype=torch.float64)


def test_the_frame_of_the_paper() -> None:
    cameras = named_rig("frame")
    assert [camera.name for camera in cameras] == ["front", "side", "top", "top45"]
    half = DISTANCE * 0.5**0.5
    wanted = torch.tensor(((0, 0, -DISTANCE), (DISTANCE, 0, 0), (0, -DISTANCE, 0), (0, -half, -half))).double()
    torch.testing.assert_close(centres_world(cameras), wanted, rtol=0, atol=1e-7)
    assert [camera.name for camera in named_rig("frame3")] == ["front", "side", "top"]
    assert (cameras[0].width, cameras[0].height) == (640, 480)
    assert float(cameras[0].intrinsics[0, 0]) == pytest.approx(520, abs=0.1)


@pytest.mark.parametrize("name", ["frame1", "frame8", "ring2", "ring", "ring12"])
def test_all_cameras_look_at_the_middle(name: str) -> None:
    cameras = named_rig(name, size=(200, 100), fov_deg=50.0)
    places = centres_world(cameras)
    torch.testing.assert_close(places.norm(dim=-1), torch.full((len(cameras),), DISTANCE).double(), rtol=0, atol=1e-7)
    for camera in cameras:
        middle = camera.project(ORIGIN)[0]
        torch.testing.assert_close(middle, torch.tensor((99.5, 49.5), dtype=torch.float64), rtol=0, atol=1e-9)
        assert float(camera.cam_from_world(ORIGIN)[0, 2]) == pytest.approx(DISTANCE)
        turned = camera.rotation @ camera.rotation.T
        torch.testing.assert_close(turned, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-12)
        assert float(camera.rotation[1, 1]) >= -1e-12  # none stands on its head
    assert float(torch.linalg.det(cameras[-1].rotation)) == pytest.approx(1)
    distances = torch.cdist(places, places) + torch.eye(len(places)).double()
    assert float(distances.min()) > 0.1
    assert len({camera.name for camera in cameras}) == len(cameras)


def test_a_ring_stands_evenly() -> None:
    places = centres_world(named_rig("ring6"))
    azimuth = torch.atan2(places[:, 0], -places[:, 2])
    steps = azimuth.diff().remainder(2 * math.pi)
    torch.testing.assert_close(steps, torch.full_like(steps, math.pi / 3), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["frame0", "frame9", "ring1", "ring40", "desk", "frame-2", ""])
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"--rig: .*frame1 to frame8, or ring2 to ring36; got"):
        named_rig(name)


def moved(camera: Camera, shift: tuple[float, float, float]) -> Camera:
    """The camera of a world whose origin lies elsewhere."""
    return replace(camera, translation=camera.translation - camera.rotation @ torch.tensor(shift, dtype=torch.float64))


@pytest.mark.parametrize("kind", ["pinhole", "orthographic"])
def test_the_stage_is_where_the_cameras_look(kind: str) -> None:
    place = (0.3, -0.1, 0.7)
    cameras = [moved(camera, place) for camera in named_rig("frame4")]
    if kind == "orthographic":
        scaled = cameras[0].intrinsics.clone()
        scaled[:2, :2] *= 2
        cameras[0] = replace(cameras[0], kind="orthographic", intrinsics=scaled)
    stage = stage_camera(cameras, 0.19)
    middle = torch.tensor(((cameras[0].width - 1) / 2, (cameras[0].height - 1) / 2), dtype=torch.float64)
    aim = meeting_point(cameras)
    torch.testing.assert_close(stage.project(aim[None])[0], middle, rtol=0, atol=1e-6)
    assert float(stage.cam_from_world(aim[None])[0, 2]) == pytest.approx(filling_distance(cameras[0], 0.19))
    torch.testing.assert_close(stage.rotation, cameras[0].rotation)


def test_a_single_camera_is_its_own_stage() -> None:
    camera = moved(named_rig("frame1")[0], (1.0, 2.0, 3.0))
    stage = stage_camera([camera], 0.19)
    assert torch.equal(stage.translation, camera.translation)


def test_cameras_that_see_nothing_together_are_named() -> None:
    front, side, top = named_rig("frame3")
    away = replace(top, rotation=torch.diag(torch.tensor((1.0, -1.0, -1.0)).double()) @ top.rotation)
    away = replace(away, translation=-away.rotation @ centres_world([top])[0])
    assert not bool(sees(away, ORIGIN))
    with pytest.raises(InputError, match=r"--rig: expected cameras that all see one place.*which top does not see"):
        stage_camera([front, side, away], 0.19)
    remote = [assumed_camera(64, 48), moved(assumed_camera(64, 48), (5.0, 0.0, 0.0))]
    with pytest.raises(InputError, match="do not see"):
        stage_camera(remote, 0.19)
