"""Calls of the effects' hooks from kernels, by address: what acts is data, and a kernel is compiled once for all that may act.

Each hook becomes a C function over many particles, points or nodes, by one of the patterns below, in which `hook` stands for the effect's
function. Its address, with those of the effect's records and table, is a row of numbers. A kernel goes through the rows and calls each;
without a row nothing is called. A pattern gets the effect's record of the step, its table `data` of `length` floats, for how many it is
called, the number of the `first` of them in what is the body's own (elsewhere they begin at 0), and `given`: the addresses of what the
hook acts on, and of what it adds to.
"""

from collections.abc import Sequence
from hashlib import sha256
from importlib import import_module
from types import FunctionType
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import carray, types

from magmpm.compiled.arrays import Index
from magmpm.compiled.by_address import address, call, floats, numbers
from magmpm.compiled.cache import c_functions
from magmpm.compiled.jit import C_OPTIONS, compiled, inlined
from magmpm.compiled.simd import WIDTH, load
from magmpm.compiled.simd_views import matrix, row, vector
from magmpm.effects.hooks import has_hook, hook_of, is_wide, pairs, registered

# What patterns act on, as addresses of flat arrays; `columns` and `kept` are numbers of columns.
#
# Particles (count,), one by one or in groups of eight: magnet (count, columns), rho (count,), x (count, 3), F (count, 3, 3), their rates
# dF (count, 3, 3), changes dmagnet (count, columns), drho (count,), and in groups what they remember, memory (count, kept).
# Points of the surface (count,): x, v (count, 3), mass (count,). Nodes: those of `nodes` (count,), with place, u, v (3 nodes,) and
# inverse_mass (3 nodes,).
# Results, by pattern: stress, second: see there.
GIVEN = np.dtype(
    [
        (name, np.int64)
        for name in (
            "magnet",
            "columns",
            "rho",
            "x",
            "F",
            "dF",
            "dmagnet",
            "drho",
            "memory",
            "kept",
            "v",
            "mass",
            "nodes",
            "place",
            "u",
            "inverse_mass",
            "value",  # energies, depths, or a factor of time
            "stress",
            "force",
            "tangent",
            "mixed",
        )
    ]
)


def hook(*_: Any) -> Any:
    """Stand for an effect's function in the patterns."""


@compiled
def _particles(at, count):
    """Arrays of what nearly all hooks of particles take: magnet, rho, x and F."""
    return (
        carray(floats(at.magnet), (count, at.columns)),
        carray(floats(at.rho), (count,)),
        carray(floats(at.x), (count, 3)),
        carray(floats(at.F), (count, 3, 3)),
    )


# Particles one by one: at rest, and in motion those of hooks that are not wide.


def energy(record, data, length, first, count, dt, given):
    """value (count,) += W, J/m^3."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    W = carray(floats(at.value), (count,))
    for p in range(count):
        W[p] += hook(effect, table, magnet[p], rho[p], x[p], F[p])


def stress(record, data, length, first, count, dt, given):
    """stress (count, 3, 3) += dW/dF, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    P = carray(floats(at.stress), (count, 3, 3))
    for p in range(count):
        hook(effect, table, magnet[p], rho[p], x[p], F[p], P[p])


def force(record, data, length, first, count, dt, given):
    """force (count, 3) -= dW/dx, N/m^3."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    f = carray(floats(at.force), (count, 3))
    for p in range(count):
        hook(effect, table, magnet[p], rho[p], x[p], F[p], f[p])


def tangent(record, data, length, first, count, dt, given):
    """tangent (count, 9, 9) += d2W/dF2, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    A = carray(floats(at.tangent), (count, 9, 9))
    for p in range(count):
        hook(effect, table, magnet[p], rho[p], x[p], F[p], A[p])


def softening(record, data, length, first, count, dt, given):
    """tangent (count, 3, 3) += d2W/dx2, N/m^4; mixed (count, 3, 9) += d2W/dx dF, N/m^3."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    H = carray(floats(at.tangent), (count, 3, 3))
    M = carray(floats(at.mixed), (count, 3, 9))
    for p in range(count):
        hook(effect, table, magnet[p], rho[p], x[p], F[p], H[p], M[p])


def stress_change(record, data, length, first, count, dt, given):
    """stress (count, 3, 3) += change of the stress with magnet and rho, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    dmagnet = carray(floats(at.dmagnet), (count, at.columns))
    drho = carray(floats(at.drho), (count,))
    P = carray(floats(at.stress), (count, 3, 3))
    for p in range(count):
        hook(effect, table, magnet[p], rho[p], dmagnet[p], drho[p], x[p], F[p], P[p])


def force_change(record, data, length, first, count, dt, given):
    """force (count, 3) += change of the force with magnet and rho, N/m^3."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    dmagnet = carray(floats(at.dmagnet), (count, at.columns))
    drho = carray(floats(at.drho), (count,))
    f = carray(floats(at.force), (count, 3))
    for p in range(count):
        hook(effect, table, magnet[p], rho[p], dmagnet[p], drho[p], x[p], F[p], f[p])


def stress_difference(record, data, length, first, count, dt, given):
    """`stress_change` of an effect that registers none: the difference of its stresses, exact where they are linear."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    dmagnet = carray(floats(at.dmagnet), (count, at.columns))
    drho = carray(floats(at.drho), (count,))
    P = carray(floats(at.stress), (count, 3, 3))
    changed = np.empty(at.columns)
    before = np.empty((3, 3))
    for p in range(count):
        before[:] = 0.0
        changed[:] = magnet[p] + dmagnet[p]
        hook(effect, table, magnet[p], rho[p], x[p], F[p], before)
        hook(effect, table, changed, rho[p] + drho[p], x[p], F[p], P[p])
        P[p] -= before


def force_difference(record, data, length, first, count, dt, given):
    """`force_change` of an effect that registers none: the difference of its forces, exact where they are linear."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    magnet, rho, x, F = _particles(at, count)
    dmagnet = carray(floats(at.dmagnet), (count, at.columns))
    drho = carray(floats(at.drho), (count,))
    f = carray(floats(at.force), (count, 3))
    changed = np.empty(at.columns)
    before = np.empty(3)
    for p in range(count):
        before[:] = 0.0
        changed[:] = magnet[p] + dmagnet[p]
        hook(effect, table, magnet[p], rho[p], x[p], F[p], before)
        hook(effect, table, changed, rho[p] + drho[p], x[p], F[p], f[p])
        f[p] -= before


def rate_stress(record, data, length, first, count, dt, given):
    """stress (count, 3, 3) += stress of the rates dF, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    _, rho, _, F = _particles(at, count)
    dF = carray(floats(at.dF), (count, 3, 3))
    P = carray(floats(at.stress), (count, 3, 3))
    for p in range(count):
        hook(effect, table, rho[p], F[p], dF[p], P[p])


# Particles in groups of eight lanes, in motion; count: of groups.


def wide_stress(record, data, length, first, count, dt, given):
    """stress (count, 3, 3, 8) += dW/dF, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    for g in range(count):
        hook(
            effect,
            table,
            vector(floats(at.magnet), WIDTH * at.columns * (first + g)),
            load(floats(at.rho), WIDTH * (first + g)),
            vector(floats(at.x), 3 * WIDTH * g),
            matrix(floats(at.F), 9 * WIDTH * g),
            matrix(floats(at.stress), 9 * WIDTH * g),
        )


def wide_force(record, data, length, first, count, dt, given):
    """force (count, 3, 8) -= dW/dx, N/m^3."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    for g in range(count):
        hook(
            effect,
            table,
            vector(floats(at.magnet), WIDTH * at.columns * (first + g)),
            load(floats(at.rho), WIDTH * (first + g)),
            vector(floats(at.x), 3 * WIDTH * g),
            matrix(floats(at.F), 9 * WIDTH * g),
            vector(floats(at.force), 3 * WIDTH * g),
        )


def wide_rate_stress(record, data, length, first, count, dt, given):
    """stress (count, 3, 3, 8) += stress of the rates dF, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    for g in range(count):
        hook(
            effect,
            table,
            load(floats(at.rho), WIDTH * (first + g)),
            matrix(floats(at.F), 9 * WIDTH * g),
            matrix(floats(at.dF), 9 * WIDTH * g),
            matrix(floats(at.stress), 9 * WIDTH * g),
        )


def wide_relax(record, data, length, first, count, dt, given):
    """stress (count, 3, 3, 8) += stress of what is remembered, which follows F for dt, Pa."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    for g in range(count):
        hook(
            effect,
            table,
            dt,
            matrix(floats(at.F), 9 * WIDTH * g),
            vector(floats(at.memory), WIDTH * at.kept * (first + g)),
            matrix(floats(at.stress), 9 * WIDTH * g),
        )


# Points of the surface, and nodes.


def near(record, data, length, first, count, dt, given):
    """value (count,): the larger of it and of how deep the points are, m."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    depth = carray(floats(at.value), (count,))
    for p in range(count):
        depth[p] = max(depth[p], hook(effect, table, row(floats(at.x), 3 * p)))


def contact(record, data, length, first, count, dt, given):
    """force (PARTS,) += push and grip of one point, N; count is 1."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    mass = carray(floats(at.mass), (count,))[0]
    hook(
        effect,
        table,
        row(floats(at.x), 0),
        row(floats(at.v), 0),
        mass,
        dt,
        row(floats(at.force), 0),
    )


def touch(record, data, length, first, count, dt, given):
    """value (count,) += energy of points at rest, J; force (count, 3) N and tangent (count, 3, 3) N/m."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    x = carray(floats(at.x), (count, 3))
    mass = carray(floats(at.mass), (count,))
    E = carray(floats(at.value), (count,))
    f = carray(floats(at.force), (count, 3))
    H = carray(floats(at.tangent), (count, 3, 3))
    for p in range(count):
        E[p] += hook(effect, table, x[p], mass[p], f[p], H[p])


def node(record, data, length, first, count, dt, given):
    """Change the velocities v of nodes, m/s."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    nodes = carray(numbers(at.nodes), (count,))
    inverse_mass = row(floats(at.inverse_mass), 0)
    for k in range(count):
        n = 3 * nodes[k]
        hook(
            effect,
            table,
            row(floats(at.place), n),
            row(floats(at.u), n),
            row(floats(at.v), n),
            inverse_mass[n] > 0.0,
            dt,
        )


def push(record, data, length, first, count, dt, given):
    """value (count,) *= seconds for which forces push in a step, over dt; count is 1."""
    effect, table, at = carray(record, 1)[0], carray(data, length), carray(given, 1)[0]
    time = carray(floats(at.value), (count,))
    time[0] *= hook(effect, table, dt)


PATTERNS: dict[str, FunctionType] = {
    function.__name__: function  # type: ignore[misc]
    for function in (
        energy,
        stress,
        force,
        tangent,
        softening,
        stress_change,
        force_change,
        stress_difference,
        force_difference,
        rate_stress,
        wide_stress,
        wide_force,
        wide_rate_stress,
        wide_relax,
        near,
        contact,
        touch,
        node,
        push,
    )
}


@inlined
def call_each(rows, step, first, count, dt, given):
    """Call the rows' functions for a step of dt (s), for `count` particles, groups, points or nodes from number `first` on.

    given: address of a record of GIVEN.
    """
    for k in range(len(rows)):
        record = rows[k, 1] + rows[k, 2] * min(step, rows[k, 3])
        call(rows[k, 0], (record, rows[k, 4], rows[k, 5], first, count, dt, given))


@compiled
def given_for():
    """Room for the addresses of what hooks act on."""
    return np.zeros(1, GIVEN)


@compiled
def particles_from(given, p, magnet, rho, x, F):
    """Give hooks the particles from number p on of magnet (n, columns), rho (n,), x (n, 3) and F (n, 3, 3)."""
    at = given[0]
    columns = magnet.shape[1]
    at.magnet, at.columns, at.rho = address(magnet, columns * p), columns, address(rho, p)
    at.x, at.F = address(x, 3 * p), address(F, 9 * p)


@compiled
def add_energies(rows, count, given, W):
    """Add the energies of the particles given to W (count,), J/m^3."""
    given[0].value = address(W, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@compiled
def add_loads(rows, count, given, P, f):
    """Add the stresses and forces of the particles given to P (count, 3, 3) Pa and f (count, 3) N/m^3."""
    at = given[0]
    at.stress, at.force = address(P, 0), address(f, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@compiled
def add_tangents(rows, count, given, A):
    """Add the tangents of the particles given to A (count, 9, 9), Pa."""
    given[0].tangent = address(A, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@compiled
def add_softenings(rows, count, given, H, M):
    """Add the second derivatives of the particles given to H (count, 3, 3) N/m^4 and M (count, 3, 9) N/m^3."""
    at = given[0]
    at.tangent, at.mixed = address(H, 0), address(M, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@compiled
def depths(rows, step, given, x, value):
    """Write the largest depth (m) of points x (n, 3) in what acts to value (n,): -inf without rows, or where that is unknown."""
    value[:] = -np.inf
    at = given[0]
    at.x, at.value = address(x, 0), address(value, 0)
    call_each(rows, step, 0, len(value), 0.0, address(given, 0))


@compiled
def push_point(rows, step, dt, given, p, x, v, mass, f):
    """Add the push and grip of point p, of x, v (n, 3) and mass (n,), to f (PARTS,)."""
    at = given[0]
    at.x, at.v, at.mass = address(x, 3 * p), address(v, 3 * p), address(mass, p)
    at.force = address(f, 0)
    call_each(rows, step, 0, 1, dt, address(given, 0))


class Function(NamedTuple):
    """A C function of an effect: its pattern, the effect's module, and the field names of its records."""

    pattern: str
    module: str
    names: tuple[str, ...]

    def hooked(self) -> tuple[Any, np.dtype[Any]]:
        """The effect's function that it calls, and the dtype of the effect's records."""
        hook_name = self.pattern.removeprefix("wide_").replace("_difference", "")
        return registered(hook_name, self.names)


_ready: dict[Any, Any] = {}  # of this process


def prepare(functions: Sequence[Function]) -> None:
    """Load C functions, or compile those that are not on the disk, once in this process."""
    new = [one for one in dict.fromkeys(functions) if (one, *one.hooked()) not in _ready]
    found = c_functions([(*_plain(one), C_OPTIONS, one) for one in new], compile_functions)
    for one, made in zip(new, found, strict=True):
        _ready[(one, *one.hooked())] = made


def compile_functions(functions: Sequence[Function]) -> None:
    """Compile functions in a process that does that for others."""
    for one in functions:
        import_module(one.module)
    prepare(functions)


def address_of(function: Function) -> int:
    """Where a function that is prepared is in this process."""
    return int(_ready[(function, *function.hooked())].address)


def _plain(function: Function) -> tuple[FunctionType, Any]:
    """The Python function that becomes a C function, and its signature."""
    pattern = PATTERNS[function.pattern]
    of, dtype = function.hooked()
    plain = of.py_func
    stamp = sha256(str(dtype.descr).encode()).hexdigest()[:8]
    name = f"{function.pattern}_by_{plain.__name__}_{stamp}"
    # Numba's symbols and files are named by these; the file's times say whether what is on disk is outdated
    code = pattern.__code__.replace(
        co_name=name, co_qualname=name, co_filename=plain.__code__.co_filename
    )
    space = {**pattern.__globals__, "hook": of, "__name__": plain.__module__}
    return FunctionType(code, space, name), types.void(
        types.CPointer(numba.from_dtype(dtype)),
        types.CPointer(types.float64),
        types.intp,
        types.intp,
        types.intp,
        types.float64,
        types.CPointer(numba.from_dtype(GIVEN)),
    )


def _module(of: Any) -> str:
    """The module of a compiled function."""
    return str(of.py_func.__module__)


def functions_of(
    named: tuple[Any, ...], *hooks: str, wide: bool | None = None
) -> list[tuple[Function, Any, Any]]:
    """The C functions of these hooks, with the records and the table of each; wide True or False: only those that serve eight particles
    at a time, or one."""
    found = []
    for records, data in pairs(named):
        for name in hooks:
            of = hook_of(name, records)
            pattern = name
            if of is None and name.endswith("_change"):
                of = hook_of(name.removesuffix("_change"), records)
                pattern = name.replace("_change", "_difference")
            if of is None or (wide is not None and is_wide(name, records) != wide):
                continue
            pattern = f"wide_{name}" if wide else pattern
            found.append((Function(pattern, _module(of), records.dtype.names), records, data))
    return found


def rows(named: tuple[Any, ...], *hooks: str, wide: bool | None = None) -> Index:
    """Rows (k, 6) by which kernels call these hooks of what acts, as long as it is kept: address of the function; address and size of the
    records, and number of the last one; address and length of the table."""
    found = functions_of(named, *hooks, wide=wide)
    prepare([function for function, _, _ in found])
    return np.array(
        [
            (
                address_of(function),
                records.ctypes.data,
                records.itemsize,
                len(records) - 1,
                data.ctypes.data,
                len(data),
            )
            for function, records, data in found
        ],
        np.int64,
    ).reshape(-1, 6)


class RestCalls(NamedTuple):
    """Rows for equilibria: energies of particles; their stresses and forces; their tangents; softening."""

    energy: Index
    load: Index
    tangent: Index
    softening: Index


class MotionCalls(NamedTuple):
    """Rows for motion: hooks of particles in groups and one by one, and whether one of them takes rates; of nodes; of points."""

    wide: Index
    narrow: Index
    rates: int
    node: Index
    push: Index
    near: Index
    contact: Index


class PointCalls(NamedTuple):
    """Rows for points of the surface: their depths and contact."""

    near: Index
    contact: Index


def at_rest(named: tuple[Any, ...]) -> RestCalls:
    """Rows for equilibria of what acts, as long as it is kept."""
    prepare(resting(named))
    return RestCalls(
        rows(named, "energy"),
        rows(named, "stress", "force"),
        rows(named, "tangent"),
        rows(named, "softening"),
    )


def of_points(named: tuple[Any, ...]) -> PointCalls:
    """Rows for points of what acts, as long as it is kept."""
    return PointCalls(rows(named, "near"), rows(named, "contact"))


def in_motion(named: tuple[Any, ...]) -> MotionCalls:
    """Rows for motion of what acts, as long as it is kept."""
    prepare(stepping(named))
    return MotionCalls(
        rows(named, "relax", "stress", "force", "rate_stress", wide=True),
        rows(named, "stress", "force", "rate_stress", wide=False),
        int(has_hook("rate_stress", named)),
        rows(named, "node"),
        rows(named, "push"),
        *of_points(named),
    )


def resting(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that equilibria call."""
    hooks = ("energy", "stress", "force", "tangent", "softening", "near", "touch")
    return [function for function, _, _ in functions_of(named, *hooks)]


def changing(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that derivatives call."""
    hooks = ("stress", "force", "stress_change", "force_change")
    return [function for function, _, _ in functions_of(named, *hooks)]


def stepping(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that steps of a motion call."""
    particles = ("relax", "stress", "force", "rate_stress")
    found = functions_of(named, *particles, wide=True)
    found += functions_of(named, *particles, wide=False)
    found += functions_of(named, "node", "push", "near", "contact")
    return [function for function, _, _ in found]


def moving(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that a motion calls, in its steps and at its frames."""
    return stepping(named) + [one for one, _, _ in functions_of(named, "energy", "stress")]
