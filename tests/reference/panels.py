"""The product with a matrix in panels, entry by entry: what factors and solutions of statics.block_cholesky are compared with."""

from magmpm.compiled.jit import compiled


@compiled
def multiply(panels, split, x, out):  # type: ignore[no-untyped-def]
    """out = A x with the unfactored panels; x, out (planes, m)."""
    planes = panels.shape[0] - 2
    m = panels.shape[1]
    out[:] = 0.0
    for j in range(planes):
        step = 1 if j < split + 2 else -1
        for k in range(3):
            row = j + step * k
            if row < 0 or row >= planes or (split <= j < split + 2 and row >= split + 2):
                continue
            for a in range(m):
                total = 0.0
                for b in range(a + 1 if k == 0 else 0, m):
                    value = panels[j, a, k * m + b]
                    out[row, b] += value * x[j, a]
                    total += value * x[row, b]
                if k == 0:
                    total += panels[j, a, a] * x[j, a]
                out[j, a] += total
