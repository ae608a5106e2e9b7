"""Parts of a scene's pictures are those of the whole pictures."""

import pytest
import torch

from torchhand.track.scene import Box, Scene, View

BOXES: tuple[Box, ...] = (
    (slice(0, 40), slice(0, 50)),
    (slice(3, 20), slice(7, 31)),
    (slice(30, 40), slice(0, 9)),
    (slice(12, 13), slice(49, 50)),
)


@pytest.fixture
def scene() -> Scene:
    generator = torch.Generator().manual_seed(0)
    image = torch.randint(0, 256, (40, 50, 3), generator=generator, dtype=torch.uint8)
    mask = torch.rand(40, 50, generator=generator) > 0.6
    return Scene(views=(View(image=image), View()), masks=(mask, None), probabilities=(None, None), time_s=0.0)


@pytest.mark.parametrize("box", BOXES)
def test_a_part_of_a_plane_is_that_of_the_whole(scene: Scene, box: Box) -> None:
    whole = Scene(views=scene.views, masks=scene.masks, probabilities=scene.probabilities, time_s=0.0)
    plane, grey = whole.plane(0), whole.grey(0)
    assert plane is not None
    assert grey is not None
    for one in (scene, whole):  # worked out for the part alone, and cut out of what is kept
        part, levels = one.plane_in(0, box), one.grey_in(0, box)
        assert part is not None
        assert levels is not None
        torch.testing.assert_close(part, plane[box], atol=1e-6, rtol=0)
        assert torch.equal(levels, grey[box])
    assert not scene.kept


def test_nothing_is_known_of_a_view_without_picture_and_mask(scene: Scene) -> None:
    box = BOXES[0]
    assert scene.plane_in(1, box) is None
    assert scene.grey_in(1, box) is None
    assert [scene.is_known(view) for view in (0, 1)] == [True, False]
