"""Heat flow on a mesh: evens out what is known at the vertices."""

import scipy.sparse as sparse
import torch
from gpytoolbox import cotangent_laplacian, massmatrix
from jaxtyping import Float, Int
from scipy.sparse.linalg import factorized
from torch import Tensor

_STEPS = 4


class Diffusion:
    """Implicit heat flow; keeps constants, sums over the surface, and on good triangles the range of the values."""

    def __init__(self, vertices: Float[Tensor, "vertices 3"], faces: Int[Tensor, "faces 3"]) -> None:
        corners, triangles = vertices.numpy(), faces.int().numpy()
        self._stiffness = cotangent_laplacian(corners, triangles)
        self._mass = massmatrix(corners, triangles, type="voronoi")
        self._solvers = {}

    def __call__(self, values: Float[Tensor, "vertices *n"], width: float) -> Float[Tensor, "vertices *n"]:
        """The values spread over `width` metres (standard deviation √2 · width)."""
        if width not in self._solvers:
            self._solvers[width] = factorized(sparse.csc_matrix(self._mass + width * width / _STEPS * self._stiffness))
        result = values.reshape(len(values), -1).numpy().copy()
        for _ in range(_STEPS):
            for column in range(result.shape[1]):
                result[:, column] = self._solvers[width](self._mass @ result[:, column])
        return torch.from_numpy(result).reshape(values.shape)
