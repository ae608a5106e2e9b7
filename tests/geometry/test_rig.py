"""What several cameras see together, and rotations read in another convention."""

import math
from dataclasses import replace

import pytest
import torch

from torchhand.devices import sent_to
from torchhand.geometry.cameras import Camera, assumed_camera
from torchhand.geometry.rig import (
    Rig,
    aim_error_deg,
    centres_world,
    common_view,
    look_away,
    meeting_point,
    rig_size,
    sees,
    suspected_reading,
)
from torchhand.geometry.rotations import rotation_from_vector

TARGET = torch.tensor((0.3, -0.2, 1.5), dtype=torch.float64)


def looking_at(centre: tuple[float, float, float], target: torch.Tensor = TARGET, *, name: str = "cam") -> Camera:
    place = torch.tensor(centre, dtype=torch.float64)
    ahead = torch.nn.functional.normalize(target - place, dim=0)
    right = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor((0.1, 1.0, 0.2)).double(), ahead), dim=0)
    rotation = torch.stack((right, torch.linalg.cross(ahead, right), ahead))
    camera = replace(assumed_camera(640, 480), name=name)
    return replace(camera, rotation=rotation, translation=-(rotation @ place))


CENTRES = ((-0.6, 0.1, 0.9), (1.3, -0.1, 1.0), (0.5, -1.2, 1.9))


@pytest.fixture
def rig() -> list[Camera]:
    return [looking_at(centre, name=f"cam{i}") for i, centre in enumerate(CENTRES)]


def test_centres_and_meeting_point(rig: list[Camera]) -> None:
    torch.testing.assert_close(centres_world(rig), torch.tensor(CENTRES).double(), atol=1e-7, rtol=0.0)
    torch.testing.assert_close(meeting_point(rig), TARGET, atol=1e-6, rtol=0.0)
    assert aim_error_deg(rig) < 1e-4
    assert rig_size(rig) == pytest.approx(math.dist(CENTRES[0], CENTRES[2]), rel=1e-6)
    assert rig_size(rig[1:2]) == pytest.approx(math.hypot(*CENTRES[1]), rel=1e-6)


def test_sees_only_what_lies_before_it_and_in_the_picture() -> None:
    camera = assumed_camera(640, 480)
    edge = camera.rays(torch.tensor([[639.0, 100.0], [650.0, 100.0]], dtype=torch.float64))[1]
    points = torch.stack((2 * edge[0], 2 * edge[1], -2 * edge[0], torch.tensor((0.0, 0.0, 5.0)).double()))
    assert sees(camera, points).tolist() == [True, False, False, True]


def test_strong_lens_does_not_fold_far_directions_into_the_picture() -> None:
    camera = replace(assumed_camera(640, 480), distortion=torch.tensor([-0.3, 0.0, 0.0, 0.0], dtype=torch.float64))
    sideways = torch.tensor([[1.8, 0.0, 1.0]], dtype=torch.float64)  # x (1 - 0.3 x²) is near zero again
    pixel = camera.project(sideways)[0]
    assert 0 <= float(pixel[0]) <= 639  # where the lens model puts it
    assert not bool(sees(camera, sideways))


def test_common_view(rig: list[Camera]) -> None:
    assert common_view(rig).tolist() == [True, True, True]
    astray = looking_at((0.0, 0.1, 0.9), torch.tensor((-3.0, 0.0, -2.0)).double())
    assert common_view([rig[0], astray, rig[2]]).tolist() == [True, False, True]
    assert (
        int(common_view([rig[0], looking_at((0.0, 0.1, 0.8), 2 * torch.tensor(CENTRES[0]).double() - TARGET)]).sum())
        == 1
    )


def test_parallel_cameras_see_a_common_volume() -> None:
    left = assumed_camera(640, 480)
    right = replace(left, translation=torch.tensor((-0.06, 0.0, 0.0), dtype=torch.float64), name="right")
    assert common_view([left, right]).all()
    assert suspected_reading([left, right]) is None
    assert not look_away([left, right])


@pytest.mark.parametrize(
    "words", ["transposed", "pose in the world, the inverse", "axes are OpenGL's", "world with OpenGL's"]
)
def test_other_conventions_are_recognised(rig: list[Camera], words: str) -> None:
    flip = torch.diag(torch.tensor((1.0, -1.0, -1.0), dtype=torch.float64))
    assert suspected_reading(rig) is None
    misread = []
    for camera in rig:
        rotation, translation = camera.rotation, camera.translation
        if "OpenGL" in words:
            rotation, translation = flip @ rotation, flip @ translation
        if "world" in words:
            rotation, translation = rotation.mT, -(rotation.mT @ translation)
        if "transposed" in words:
            rotation = rotation.mT
        misread.append(replace(camera, rotation=rotation.contiguous(), translation=translation))
    assert words in (suspected_reading(misread) or "")


def test_slightly_diverging_pair_is_not_suspected_of_looking_apart() -> None:
    left = assumed_camera(640, 480)
    turn = rotation_from_vector(torch.tensor((0.0, -0.03, 0.0), dtype=torch.float64))
    right = replace(left, rotation=turn, translation=torch.tensor((-0.06, 0.0, 0.0), dtype=torch.float64))
    assert aim_error_deg([left, right]) > 90
    assert not look_away([left, right])


def test_a_rig_is_its_cameras(rig: list[Camera]) -> None:
    own = Rig(rig)
    assert list(own) == rig
    assert own.names == ("cam0", "cam1", "cam2")
    assert own.named("cam1") is rig[1]
    points = TARGET + 0.1 * torch.eye(3).double()
    projected = own.project(points)
    assert projected.shape == (3, 3, 2)
    assert torch.equal(projected[2], rig[2].project(points))


def test_a_rig_in_another_unit_sees_the_same(rig: list[Camera]) -> None:
    inches = Rig(rig).scaled(1 / 0.0254)
    torch.testing.assert_close(inches.project(TARGET / 0.0254), Rig(rig).project(TARGET))
    assert math.isclose(rig_size(inches.scaled(0.0254)), rig_size(rig))
    single = Rig(rig).to(dtype=torch.float32)
    assert all(camera.rotation.dtype == torch.float32 for camera in single)
    sent = sent_to(Rig(rig), torch.device("meta"))
    assert isinstance(sent, Rig)
    assert all(camera.rotation.is_meta for camera in sent)


def test_wrong_rigs_are_refused(rig: list[Camera]) -> None:
    with pytest.raises(ValueError, match="at least one, got none"):
        Rig([])
    batch = replace(rig[0], rotation=rig[0].rotation.expand(2, 3, 3), translation=rig[0].translation.expand(2, 3))
    with pytest.raises(ValueError, match="single ones, got a batch"):
        Rig([rig[0], batch])
    with pytest.raises(ValueError, match="expected one of cam0, cam1, cam2, each once, got 'left'"):
        Rig(rig).named("left")
    with pytest.raises(ValueError, match="each once"):
        Rig([rig[0], rig[0]]).named("cam0")
