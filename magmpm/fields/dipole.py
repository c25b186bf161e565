"""The field of a point dipole, and its first and second derivatives, in closed form.

B = k (3 (m . d) d / r^5 - m / r^3), k = mu0 / 4 pi, d from the dipole to the point. With a moment n at that point,
n . B = k (3 (m . d) (n . d) / r^5 - (m . n) / r^3), whose derivatives give force and tangent. Outside a uniformly magnetized sphere
the field is exactly this; within `radius` of the dipole the functions give the sphere's inner field, constant 2 k m / radius^3, so that
they stay finite. Source: Jackson, Classical Electrodynamics, 3rd ed., sections 5.6 and 5.10.

A dipole stands in `data` as position (3) m, moment (3) A m^2, radius m.
"""

import math

from magmpm.compiled.jit import compiled, inner

# Vacuum permeability, T m/A, as the SI defined it until 2019. scipy.constants.mu_0, which is measured since then, is less by 1.3e-10 of it;
# remanences are known to some 1e-2, and the references that results are compared with use this value.
MU0 = 4e-7 * math.pi
DIPOLE_SIZE = 7
K = 1e-7  # mu0 / 4 pi, T m/A
POINT = 1e-6  # m, radius of a dipole that is given none


@inner
def _seen(data, at, y0, y1, y2):
    """A dipole seen from a place: the way to it (3) m and its square, the moment (3) A m^2, and the radius, m."""
    x = y0 - data[at]
    y = y1 - data[at + 1]
    z = y2 - data[at + 2]
    r2 = x * x + y * y + z * z
    return x, y, z, r2, data[at + 3], data[at + 4], data[at + 5], data[at + 6]


@compiled
def value(data, at, y0, y1, y2):
    """B (3), T."""
    x, y, z, r2, m0, m1, m2, a = _seen(data, at, y0, y1, y2)
    if r2 < a * a:
        inside = 2 * K / a**3
        return inside * m0, inside * m1, inside * m2
    s = K / (r2 * r2 * (r2**0.5))
    p = 3.0 * (m0 * x + m1 * y + m2 * z)
    return s * (p * x - m0 * r2), s * (p * y - m1 * r2), s * (p * z - m2 * r2)


@compiled
def gradient(data, at, y0, y1, y2):
    """dB_i/dy_j (9), row i, T/m: 3 k/r^5 (m_i d_j + d_i m_j + (m . d) (delta_ij - 5 d_i d_j/r^2))."""
    x, y, z, r2, m0, m1, m2, a = _seen(data, at, y0, y1, y2)
    if r2 < a * a:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    s = 3.0 * K / (r2 * r2 * (r2**0.5))
    p = m0 * x + m1 * y + m2 * z
    q = 5.0 * p / r2
    xx = s * (2 * m0 * x + p - q * x * x)
    yy = s * (2 * m1 * y + p - q * y * y)
    zz = s * (2 * m2 * z + p - q * z * z)
    xy = s * (m0 * y + x * m1 - q * x * y)
    xz = s * (m0 * z + x * m2 - q * x * z)
    yz = s * (m1 * z + y * m2 - q * y * z)
    return xx, xy, xz, xy, yy, yz, xz, yz, zz


@compiled
def curvature(data, at, y0, y1, y2, n0, n1, n2):
    """Second derivatives xx, yy, zz, xy, xz, yz of n . B.

    3 k/r^5 [ m_i n_j + n_i m_j + (m . n) delta_ij - 5/r^2 ((m . d)(n_i d_j + d_i n_j) + (n . d)(m_i d_j + d_i m_j)
              + ((m . d)(n . d) delta_ij + (m . n) d_i d_j)) + 35/r^4 (m . d)(n . d) d_i d_j ]
    """
    x, y, z, r2, m0, m1, m2, a = _seen(data, at, y0, y1, y2)
    if r2 < a * a:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    s = 3.0 * K / (r2 * r2 * (r2**0.5))
    md = m0 * x + m1 * y + m2 * z
    nd = n0 * x + n1 * y + n2 * z
    mn = m0 * n0 + m1 * n1 + m2 * n2
    five = 5.0 / r2
    both = 35.0 * md * nd / (r2 * r2) - five * mn
    same = mn - five * md * nd
    xx = s * (2 * m0 * n0 + same - five * 2 * (md * n0 * x + nd * m0 * x) + both * x * x)
    yy = s * (2 * m1 * n1 + same - five * 2 * (md * n1 * y + nd * m1 * y) + both * y * y)
    zz = s * (2 * m2 * n2 + same - five * 2 * (md * n2 * z + nd * m2 * z) + both * z * z)
    xy = s * (
        m0 * n1 + n0 * m1 - five * (md * (n0 * y + x * n1) + nd * (m0 * y + x * m1)) + both * x * y
    )
    xz = s * (
        m0 * n2 + n0 * m2 - five * (md * (n0 * z + x * n2) + nd * (m0 * z + x * m2)) + both * x * z
    )
    yz = s * (
        m1 * n2 + n1 * m2 - five * (md * (n1 * z + y * n2) + nd * (m1 * z + y * m2)) + both * y * z
    )
    return xx, yy, zz, xy, xz, yz
