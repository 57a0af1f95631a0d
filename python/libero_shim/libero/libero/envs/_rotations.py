"""Relative poses with robosuite's rounding.

robosuite computes rotations in single precision. This module reproduces its rounding, because
policies were trained on observations rounded in this way. Quaternions are x y z w."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def relative_poses(
    positions: F64, quaternions: F64, base_position: F64, base_quaternion: F64
) -> tuple[F64, F32]:
    """Returns the positions [n, 3], m, and unit quaternions [n, 4], w ≥ 0, of poses relative to a
    base pose [3] and [4]."""
    base = _matrices(base_quaternion[np.newaxis])[0].astype(np.float64)
    to_base = base.T
    shift = -to_base @ base_position.astype(np.float32)
    rotations = to_base @ _matrices(quaternions)
    return (
        positions.astype(np.float32).astype(np.float64) @ to_base.T + shift,
        quaternions_of(rotations),
    )


def _matrices(quaternions: F64) -> F32:
    """Rotation matrices [n, 3, 3] of quaternions [n, 4]."""
    q = quaternions[:, [3, 0, 1, 2]].astype(np.float32)
    # The factor is computed in double precision; the product is rounded once.
    norms = np.einsum("ni,ni->n", q, q).astype(np.float64)
    q = (q * np.sqrt(2.0 / norms)[:, np.newaxis]).astype(np.float32)
    w, x, y, z = range(4)
    p = (q[:, :, np.newaxis] * q[:, np.newaxis, :]).astype(np.float64)
    rows = [
        [1.0 - p[:, y, y] - p[:, z, z], p[:, x, y] - p[:, z, w], p[:, x, z] + p[:, y, w]],
        [p[:, x, y] + p[:, z, w], 1.0 - p[:, x, x] - p[:, z, z], p[:, y, z] - p[:, x, w]],
        [p[:, x, z] - p[:, y, w], p[:, y, z] + p[:, x, w], 1.0 - p[:, x, x] - p[:, y, y]],
    ]
    return np.moveaxis(np.array(rows), 2, 0).astype(np.float32)


def quaternions_of(rotations: F64) -> F32:
    """Quaternions [n, 4] of rotation matrices [n, 3, 3], as the eigenvectors of the largest
    eigenvalue of Bar-Itzhack's matrices."""
    m = rotations.astype(np.float32)
    k = np.zeros((len(m), 4, 4), dtype=np.float32)
    # The lower triangles, in the order x, y, z, w, are sufficient.
    for i, (j, n) in enumerate(((1, 2), (0, 2), (0, 1))):
        k[:, i, i] = m[:, i, i] - m[:, j, j] - m[:, n, n]
    k[:, 1, 0] = m[:, 0, 1] + m[:, 1, 0]
    k[:, 2, 0] = m[:, 0, 2] + m[:, 2, 0]
    k[:, 2, 1] = m[:, 1, 2] + m[:, 2, 1]
    k[:, 3, 0] = m[:, 2, 1] - m[:, 1, 2]
    k[:, 3, 1] = m[:, 0, 2] - m[:, 2, 0]
    k[:, 3, 2] = m[:, 1, 0] - m[:, 0, 1]
    k[:, 3, 3] = m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    _, vectors = np.linalg.eigh(k / np.float32(3.0))
    # Eigenvalues come in ascending order.
    q = vectors[:, :, 3]
    return np.where(q[:, 3:] < 0.0, -q, q)
