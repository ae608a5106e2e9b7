"""Limb segments as the filter's observation: against the outline's points, autograd and slow loops; masks and noise."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.hand import CONE_NAMES, DOFS, PoseSpace, named_pose_space, posture
from torchhand.numerics import Gaussian, IteratedSettings, Measurement, update_extended, update_iterated
from torchhand.track.extended.segment_jacobian import SEGMENT_NAMES
from torchhand.track.extended.segment_observation import (
    OBSERVED,
    SegmentObservation,
    SegmentSettings,
    foreshortening,
    segment_values,
)
from torchhand.view import HandProjector, OutlineTable


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def observed(placed: Any, name: str = "dof26", settings: SegmentSettings | None = None) -> SegmentObservation:
    space = named_pose_space(name).about(placed.pose)
    return SegmentObservation(placed.projector, space, placed.root_reference, settings)


def poses(space: PoseSpace, *batch: int, seed: int = 0, spread: float = 0.15) -> Tensor:
    """Free parameters about the placed pose: centimetres and tenths of a radian."""
    free = spread * randn(*batch, space.size, seed=seed)
    scale = torch.tensor([0.05 if name.startswith("root_t") else 1.0 for name in space.free_names], dtype=torch.float64)
    return free * scale


CAMERAS: dict[str, dict[str, Any]] = {"pinhole": {}, "lens": {"lens": True}, "orthographic": {"kind": "orthographic"}}


@pytest.mark.parametrize("name", ["planar_abduction", "dof26", "dof36"])
@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_closed_form_is_autograds_derivative(studio: Any, side: str, camera: str, name: str) -> None:
    placed = studio.placed(side=side, camera=studio.camera(**CAMERAS[camera]), angle_deg=20.0)
    observe = observed(placed, name)
    free = poses(observe.space, 2)
    value, jacobian = observe(free)
    torch.testing.assert_close(value, observe.value(free), atol=1e-12, rtol=0)
    by_row = torch.func.vmap(torch.func.jacrev(observe.value))(free)
    torch.testing.assert_close(jacobian, by_row, atol=1e-10, rtol=0)


def test_a_tied_angle_stops_at_its_limit_and_the_free_one_goes_on(studio: Any) -> None:
    placed = studio.placed()
    observe = observed(placed, "dof26")
    free = torch.zeros(observe.space.size, dtype=torch.float64)
    free[list(observe.space.free_names).index("thumb_cmc_fe")] = -0.3
    stopped = observe.space.dof(free)
    at = DOFS.index("thumb_mcp_fe")
    assert float(stopped[at]) < float(placed.kinematics.skeleton.lower[at - 6])
    stopped[at] = placed.kinematics.skeleton.lower[at - 6]
    free_angles = observed(placed, "dof36")
    expected = free_angles.value(free_angles.space.own(stopped))
    torch.testing.assert_close(observe.value(free), expected, atol=1e-10, rtol=0)
    by_row = torch.func.jacrev(observe.value)(free)
    torch.testing.assert_close(observe(free)[1], by_row, atol=1e-10, rtol=0)


def test_the_closed_form_holds_for_a_camera_anywhere_and_a_bent_hand(studio: Any) -> None:
    placed = studio.placed()
    turn = rotation_from_vector(torch.tensor([0.3, -0.2, 0.9], dtype=torch.float64))
    shift = torch.tensor([0.02, -0.03, 0.1], dtype=torch.float64)
    camera = replace(placed.camera, rotation=turn, translation=shift)
    pose = posture("point", dtype=torch.float64)
    pose[:3] = turn.mT @ (placed.pose[:3] - shift)
    projector = HandProjector(placed.kinematics, camera, placed.shape)
    observe = SegmentObservation(projector, named_pose_space("dof31").about(pose), turn.mT @ placed.root_reference)
    free = poses(observe.space, 3, seed=4)
    by_row = torch.stack([torch.autograd.functional.jacobian(observe.value, row) for row in free])
    real = observe.segments(free).is_real.repeat_interleave(4, -1)
    assert int(real.sum()) > 180
    torch.testing.assert_close(observe(free)[1][real], by_row[real], atol=1e-9, rtol=1e-10)


def test_values_are_those_of_the_outlines_ends(studio: Any) -> None:
    """A slow loop over single outline points, by name."""
    placed = studio.placed(angle_deg=-30.0)
    observe = observed(placed)
    free = poses(observe.space, seed=1)
    value = observe.value(free).reshape(20, 4)
    pose = observe.space.dof(free)
    for row, name in zip(value, SEGMENT_NAMES, strict=True):
        cone, side = name.rsplit("_", 1)
        one = torch.tensor([CONE_NAMES.index(cone)] * 2)
        table = OutlineTable(
            cone=one,
            cone_side=torch.tensor([int(side)] * 2),
            cone_fraction=torch.tensor([0.0, 1.0], dtype=torch.float64),
            ellipsoid=one[:0],
            ellipsoid_fraction=torch.zeros(0, dtype=torch.float64),
        )
        (x0, y0), (x1, y1) = placed.projector.outline_px(pose, placed.root_reference, table).tolist()
        direction = math.atan((y1 - y0) / (x1 - x0))  # of a line, whichever end comes first
        expected = [(x0 + x1) / 2, (y0 + y1) / 2, math.hypot(x1 - x0, y1 - y0), direction]
        assert row.tolist() == pytest.approx(expected, abs=1e-9)
    assert [name.split("_")[0] for name in SEGMENT_NAMES[::4]] == ["thumb", "index", "middle", "ring", "little"]


def test_segments_lie_beside_their_phalanx(studio: Any) -> None:
    """Both sides run along the bone, at its radius, left and right of it."""
    placed = studio.placed()
    ends = observed(placed).segments(torch.zeros(26, dtype=torch.float64)).ends_px.reshape(5, 2, 2, 2, 2)
    joints = placed.keypoints_px[1:].reshape(5, 4, 2)  # base, two joints, tip of every finger
    for finger in range(5):
        for phalanx in range(2):
            start, stop = joints[finger, 1 + phalanx], joints[finger, 2 + phalanx]
            along = (stop - start) / (stop - start).norm()
            middles = ends[finger, phalanx].mean(-2) - start
            across = middles[:, 0] * along[1] - middles[:, 1] * along[0]
            assert float(across.prod()) < 0
            assert float(across.abs().min()) > 2
            rise = ends[finger, phalanx, :, 1] - ends[finger, phalanx, :, 0]
            assert bool((rise @ along > 0.9 * rise.norm(dim=-1)).all())


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_a_batch_is_a_loop_with_references_and_shapes_of_its_own(studio: Any, batch: tuple[int, ...]) -> None:
    placed = studio.placed()
    space = named_pose_space("dof26").about(placed.pose)
    references = rotation_from_vector(0.2 * randn(*batch, 3, seed=1)) @ placed.root_reference
    shapes = placed.shape * (1 + 0.02 * randn(*batch, len(placed.shape), seed=2))
    free, covariance = poses(space, *batch, seed=3), 1e-4 * torch.eye(26, dtype=torch.float64).expand(*batch, 26, 26)
    observe = SegmentObservation(HandProjector(placed.kinematics, placed.camera, shapes), space, references)
    value, jacobian = observe(free)
    measured = observe.measure(free, covariance)
    flat = zip(*(x.reshape(-1, *x.shape[len(batch) :]) for x in (free, references, shapes)), strict=True)
    for i, (row, reference, shape) in enumerate(flat):
        alone = SegmentObservation(HandProjector(placed.kinematics, placed.camera, shape), space, reference)
        one, of_one = alone(row)
        single = alone.measure(row, covariance.reshape(-1, 26, 26)[0])
        torch.testing.assert_close(value.reshape(-1, 80)[i], one, atol=1e-10, rtol=0)
        torch.testing.assert_close(jacobian.reshape(-1, 80, 26)[i], of_one, atol=1e-9, rtol=0)
        torch.testing.assert_close(measured.noise.reshape(-1, 80, 80)[i], single.noise, atol=1e-9, rtol=0)
        assert torch.equal(measured.valid.reshape(-1, 80)[i], single.valid)


def test_an_open_hand_shows_all_segments_and_a_bent_finger_hides_its_own(studio: Any) -> None:
    placed = studio.placed()
    observe = observed(placed, "dof36")
    open_hand = torch.zeros(36, dtype=torch.float64)
    assert observe.usable(open_hand).all()
    # most of every segment is seen, and less than half of the middle finger's under the palm, seen from the back
    assert observed(placed, "dof36", SegmentSettings(min_visible=0.7)).usable(open_hand).all()
    behind = studio.placed(view="back", posed="open")
    curled = torch.zeros(36, dtype=torch.float64)
    for dof, angle in (("middle_mcp_fe", 85.0), ("middle_pip_fe", 100.0), ("middle_dip_fe", 67.0)):
        curled[DOFS.index(dof)] = math.radians(angle)
    is_middle = torch.tensor([name.startswith("middle") for name in SEGMENT_NAMES])
    assert not observed(behind, "dof36", SegmentSettings(min_visible=0.5)).usable(curled)[is_middle].any()
    usable = observed(behind, "dof36").usable(curled)
    assert usable[~is_middle].all()
    assert not usable[is_middle].any()
    blind = observed(behind, "dof36", SegmentSettings(min_visible=0.0))
    assert blind.usable(curled)[8:10].all()  # it is hiding alone that leaves the middle phalanx out


def test_a_phalanx_that_points_at_the_camera_is_left_out_and_its_length_is_unsure_before(studio: Any) -> None:
    observe = observed(studio.placed(), "dof36")
    bend = torch.zeros(5, 36, dtype=torch.float64)
    angles = torch.tensor([0.0, 30.0, 45.0, 60.0, 88.0], dtype=torch.float64).deg2rad()
    bend[:, DOFS.index("index_mcp_fe")] = angles
    segments = observe.segments(bend)
    facing = foreshortening(segments.ends_cam)[:, 4:8]  # index, middle and distal phalanx
    torch.testing.assert_close(facing.mean(-1), angles.cos(), atol=0.12, rtol=0)
    std = observe.variances(bend).reshape(5, 20, 4).sqrt()
    assert bool((std[1:4, 4:8, 2] > std[:3, 4:8, 2]).all())
    torch.testing.assert_close(std[:4, 4:8, 2], 1.5 / facing[:4], atol=1e-12, rtol=0)
    torch.testing.assert_close(std[:, :4], std[:1, :4].expand(5, 4, 4), atol=1e-12, rtol=0)  # the thumb has not moved
    length = segment_values(segments.ends_px).reshape(5, 20, 4)[..., 2]
    torch.testing.assert_close(std[..., 3][length > 3], 1 / length[length > 3], atol=1e-12, rtol=0)
    assert (std[..., :2] == 1).all()
    usable = observe.usable(bend)
    assert usable[:4].all()
    assert not usable[4, 4:8].any()


def test_segments_outside_the_picture_or_behind_the_camera_are_left_out(studio: Any) -> None:
    placed = studio.placed()
    observe = observed(placed, "dof36")
    shifted = torch.zeros(2, 36, dtype=torch.float64)
    shifted[0, 0] = 0.5
    shifted[1, 2] = -2 * float(placed.pose[2])
    assert not observe.usable(shifted).any()
    assert not observe.segments(shifted).is_real[1].any()


def test_directions_are_modulo_pi_and_all_else_is_not(studio: Any) -> None:
    observe = observed(studio.placed())
    assert observe.period.shape == (OBSERVED,)
    assert observe.period.reshape(20, 4).tolist() == [[math.inf, math.inf, math.inf, math.pi]] * 20
    ends = randn(20, 2, 2, seed=1)
    values = segment_values(ends)
    torch.testing.assert_close(segment_values(ends.flip(-2)), values, atol=1e-13, rtol=0)
    assert float(values.reshape(20, 4)[:, 3].abs().max()) <= math.pi / 2
    upright = torch.tensor([[0.0, 0.0], [0.0, 3.0]], dtype=torch.float64).expand(20, 2, 2)
    for line in (upright, -upright):
        assert segment_values(line).reshape(20, 4)[:, 3].tolist() == [math.pi / 2] * 20


def belief(size: int, scale: Tensor) -> Gaussian:
    """Positions and velocities that are correlated, as after a prediction."""
    root = (
        torch.eye(2 * size, dtype=torch.float64) + 0.5 * torch.eye(2 * size, dtype=torch.float64).roll(size, 0).tril()
    )
    root = root * torch.cat((scale, scale))[:, None]
    return Gaussian(torch.zeros(2 * size, dtype=torch.float64), root @ root.mT)


def test_with_the_registrations_covariance_the_filter_sees_the_pose_itself(studio: Any) -> None:
    """Eighty numbers with noise H Σ Hᵀ say what the free parameters with noise Σ say, in the linear limit."""
    observe = observed(studio.placed(), "planar_abduction")
    size = observe.space.size
    scale = torch.tensor([1e-8 if n.startswith("root_t") else 1e-7 for n in observe.space.free_names]).double()
    state, truth = belief(size, scale), scale * randn(size, seed=2)
    root = scale[:, None] * (torch.eye(size, dtype=torch.float64) + 0.3 * randn(size, size, seed=3))
    covariance = root @ root.mT
    settings = SegmentSettings(position_std_px=1e-8, length_std_px=1e-8)
    observe = SegmentObservation(observe.projector, observe.space, observe.root_reference, settings)
    measured = observe.measure(truth, covariance)
    value, jacobian = observe(state.mean[:size])
    innovation = measured.value - value
    got = update_extended(state, innovation, jacobian, measured.noise, valid=measured.valid)
    direct = update_extended(state, truth, torch.eye(size, dtype=torch.float64), covariance)
    units = torch.cat((scale, scale))
    torch.testing.assert_close(got.state.mean / units, direct.state.mean / units, atol=2e-3, rtol=0)
    torch.testing.assert_close(
        got.state.covariance / units / units[:, None],
        direct.state.covariance / units / units[:, None],
        atol=2e-3,
        rtol=0,
    )


def test_the_iterated_filter_finds_the_registered_pose_from_far_away(studio: Any) -> None:
    """Six degrees off in the turn and in every angle, and past upright: one linearisation is not enough.

    The fingers are bent, since straight ones seen from before look the same a little forwards and backwards.
    """
    placed = studio.placed()
    bent = torch.tensor([0.5 * name.endswith(("mcp_fe", "pip_fe")) for name in DOFS], dtype=torch.float64)
    settings = SegmentSettings(position_std_px=0.3, length_std_px=0.3)
    observe = observed(replace(placed, pose=placed.pose + bent), "dof26", settings)
    size, count = observe.space.size, 10
    truth = poses(observe.space, count, seed=7, spread=0.1)
    scale = torch.tensor([0.005 if n.startswith("root_t") else 0.1 for n in observe.space.free_names]).double()
    start = belief(size, scale)
    state = Gaussian(start.mean.expand(count, -1), start.covariance.expand(count, -1, -1))
    measured = observe.measure(truth)
    options: dict[str, Any] = {"period": observe.period, "observed": size}
    turned = (measured.value - observe.value(state.mean[:, :size]))[measured.valid & observe.period.isfinite()]
    assert int((turned.abs() > math.pi / 2).sum()) >= 5  # met only by wrapping
    is_seen = measured.valid.reshape(count, 20, 4)[..., 0]

    def error_px(mean: Tensor) -> Tensor:
        error = observe.value(mean[:, :size]) - measured.value
        return error.reshape(count, 20, 4)[..., :2].norm(dim=-1)[is_seen]

    seen = Measurement(measured.value, measured.noise, measured.valid)
    got = update_iterated(state, observe, seen, **options)
    one = update_iterated(state, observe, seen, IteratedSettings(iterations=1), **options)
    assert got.is_converged.all()
    assert float(error_px(got.update.state.mean).max()) < 0.3
    assert float(error_px(one.update.state.mean).mean()) > 10 * float(error_px(got.update.state.mean).mean())
    deviation = (got.update.state.mean[:, :size] - truth) / got.update.state.std[:, :size]
    assert float(deviation.square().mean()) < 1.5  # the covariance tells the truth
    without = {**options, "period": torch.full_like(observe.period, math.inf)}
    lost = update_iterated(state, observe, seen, **without)
    assert float(error_px(lost.update.state.mean).max()) > 3


def test_gradients_reach_the_shape(studio: Any) -> None:
    placed = studio.placed()
    space = named_pose_space("planar_scale").about(placed.pose)
    columns = [placed.kinematics.shape_space.names.index(n) for n in ("hand_length", "hand_breadth")]

    def lengths(part: Tensor) -> Tensor:
        shape = placed.shape.index_copy(0, torch.tensor(columns), part)
        projector = HandProjector(placed.kinematics, placed.camera, shape)
        observe = SegmentObservation(projector, space, placed.root_reference)
        return observe.value(torch.zeros(4, dtype=torch.float64))[2::4]

    part = placed.shape[columns].clone().requires_grad_()
    assert torch.autograd.gradcheck(lengths, (part,))
    (slope,) = torch.autograd.grad(lengths(part).sum(), part)
    assert float(slope[0]) > 0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"position_std_px": 0.0}, r"segments\.position_std_px: expected above 0 and finite, got 0\.0"),
        ({"min_visible": 1.5}, r"segments\.min_visible: expected 0 to 1, got 1\.5"),
    ],
)
def test_settings_are_checked(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SegmentSettings(**values)
