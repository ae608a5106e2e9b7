"""Products with the batch last against ordinary matrix products."""

import pytest
import torch

from torchhand.geometry.batch_last import batch_first, batch_last, compose, cross, turn, turn_back


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("is_shared", [False, True])
def test_products(batch: tuple[int, ...], is_shared: bool, generator: torch.Generator) -> None:
    left = torch.randn(*batch, 4, 3, 3, generator=generator, dtype=torch.float64)
    own = () if is_shared else batch
    right = torch.randn(*own, 4, 3, 3, generator=generator, dtype=torch.float64)
    vector = torch.randn(*own, 4, 3, generator=generator, dtype=torch.float64)
    lefts, rights, vectors = batch_last(left, 3, batch), batch_last(right, 3, batch), batch_last(vector, 2, batch)
    torch.testing.assert_close(batch_first(compose(lefts, rights), batch), left @ right)
    torch.testing.assert_close(batch_first(turn(lefts, vectors), batch), (left @ vector[..., None]).squeeze(-1))
    torch.testing.assert_close(batch_first(turn_back(lefts, vectors), batch), (left.mT @ vector[..., None]).squeeze(-1))
    column = left[..., 0]
    product = batch_first(cross(batch_last(column, 2, batch), vectors), batch)
    torch.testing.assert_close(product, torch.linalg.cross(column, vector.expand_as(column)))
    torch.testing.assert_close(batch_first(lefts, batch), left, atol=0, rtol=0)
