"""Transmission zeros of a linear system, which no feedback can move."""

import numpy as np
from jaxtyping import Complex


_RANK = 1e-9
"""Singular value, for rows of size one, below which an input has no effect on an output"""

_BALANCING = 20
"""Number of rounds of balancing, each of which makes rows and columns more equal in size"""


def transmission_zeros(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> Complex[np.ndarray, " zeros"] | None:
    """Finite zeros of x' = a x + b u, y = c x + d u, with as many outputs as inputs.

    The zeros are the numbers s at which the Rosenbrock matrix, [[a - s I, b], [c, d]], is
    singular. They are the eigenvalues of the motion that remains when the inputs hold all
    outputs at zero. High gains drive the eigenvalues of a closed loop into the zeros; if a
    zero has a positive real part, the loop then diverges. States on which no output depends
    count as zeros too.

    Each output is differentiated until the inputs appear, so that there are no infinite
    zeros to separate from large ones: A. Emami-Naeini and P. Van Dooren, "Computation of
    Zeros of Linear Multivariable Systems", Automatica 18(4), 1982.

    **Returns:** the zeros. None if the matrix is singular at all s: two inputs have the
    same effect, or an input has no effect.

    **Raises:** `ValueError` for matrices that do not fit together or are not finite, and if
    the numbers of outputs and inputs differ.
    """
    n, m = np.shape(b)
    shapes = [np.shape(x) for x in (a, c, d)]
    if shapes != [(n, n), (m, n), (m, m)]:
        raise ValueError(
            f"a, b, c and d have shapes {shapes[0]}, {(n, m)}, {shapes[1]} and "
            f"{shapes[2]}: for n states and m inputs and outputs they must be (n, n), "
            "(n, m), (m, n) and (m, m)"
        )
    system = np.block([[a, b], [c, d]])
    if not np.all(np.isfinite(system)):
        raise ValueError("a, b, c and d must be finite numbers")
    a, b, c, d = _parts(_balanced(system, n), n)
    while True:
        size = np.linalg.norm(np.hstack([c, d]), axis=1, keepdims=True)
        if np.any(size == 0.0):
            return None
        c, d = c / size, d / size
        left, strength, _ = np.linalg.svd(d)
        rank = int(np.sum(strength > _RANK))
        if rank == m:
            return np.linalg.eigvals(a - b @ np.linalg.solve(d, c)).astype(complex)
        # Combinations of the outputs without a direct effect of the inputs.
        c, d = left.T @ c, left.T @ d
        silent = c[rank:]
        if np.linalg.matrix_rank(silent, _RANK) < len(silent):
            return None
        # If these are held at zero, the states in their null space remain. Their rates,
        # which are those of the other states, are the next outputs.
        _, _, right = np.linalg.svd(silent)
        fixed, free = right[: len(silent)], right[len(silent) :]
        c = np.vstack([c[:rank], fixed @ a]) @ free.T
        d = np.vstack([d[:rank], fixed @ b])
        a, b = free @ a @ free.T, free @ b


def _parts(system: np.ndarray, n: int) -> tuple[np.ndarray, ...]:
    return system[:n, :n], system[:n, n:], system[n:, :n], system[n:, n:]


def _balanced(system: np.ndarray, n: int) -> np.ndarray:
    """The system in units of states, inputs and outputs that balance its numbers.

    The unit of a state divides its row and multiplies its column. It is chosen so that both
    have equal size: E. E. Osborne, "On Pre-Conditioning of Matrices", Journal of the ACM
    7(4), 1960. The units of outputs and inputs give their rows and columns size one.
    """
    system = np.array(system, float)
    for _ in range(_BALANCING):
        for i in range(len(system)):
            others = np.arange(len(system)) != i
            row = np.linalg.norm(system[i, others])
            column = np.linalg.norm(system[others, i])
            if i < n and row > 0.0 and column > 0.0:
                unit = np.sqrt(row / column)
                system[i] /= unit
                system[:, i] *= unit
            elif i >= n:  # an output has its own row, and an input its own column
                row = np.linalg.norm(system[i])
                system[i] /= row if row > 0.0 else 1.0
                column = np.linalg.norm(system[:, i])
                system[:, i] /= column if column > 0.0 else 1.0
    return system
