"""Calls of the effects' hooks from kernels, by address: what acts is data, and a kernel is compiled once for all that may act.

Hooks become C functions over many particles, points or nodes, by the patterns below, in which `energy_hook` and others stand for the
effect's functions, or for nothing where it has none. The address of a C function, with those of the effect's records and table, is a row of
numbers. A kernel goes through the rows and calls each; without a row nothing is called. A pattern gets the effect's record of the step, its
table `data` of `length` floats, for how many it is called, the number of the `first` of them in what is the body's own (elsewhere they
begin at 0), and `given`: the addresses of what the hook acts on, and of what it adds to.
"""

from collections.abc import Sequence
from hashlib import sha256
from importlib import import_module
from types import FunctionType
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import carray, types

from magmpm.compiled.arrays import Index, Plain
from magmpm.compiled.by_address import address, call, floats, numbers
from magmpm.compiled.cache import c_functions
from magmpm.compiled.jit import C_OPTIONS, compiled, compiled_elsewhere, inlined, inner
from magmpm.compiled.simd import WIDTH, larger, store
from magmpm.compiled.simd import load as lanes_at
from magmpm.compiled.simd_views import matrix, row, vector
from magmpm.effects.contact_force import PARTS
from magmpm.effects.hooks import dtype_of, has_hook, hooks_of, is_wide, module_of, pairs

# What patterns act on, and add to, as addresses of flat arrays.
#
# Particles (count,), one by one or in groups of eight: magnet (count, columns) T, rho (count,) kg/m^3, x (count, 3) m, F (count, 3, 3), its
# rate dF 1/s, changes dmagnet (count, columns) and drho (count,), and in groups what they remember, memory (count, kept); they add to
# stress (count, 3, 3) Pa, force (count, 3) N/m^3, tangent (count, 9, 9) Pa, bend (count, 3, 3) N/m^4 and mixed (count, 3, 9) N/m^3.
# Points of the surface (count,): x (count, 3), mass (count,); they add to force N and bend (count, 3, 3) N/m.
# Pieces of the surface in a fluid (count,): x, v and normal (count, 3), law (count, columns); they add to force (count, 3) N.
# Nodes (count,), by their numbers `nodes` in place, u, v and inverse_mass (3 nodes,).
# value (count,): energies, depths, or seconds. force (count, PARTS) of points in motion, in groups of eight: effects.contact_force.
_OF_PARTICLES = ("magnet", "columns", "rho", "x", "F", "dF", "dmagnet", "drho", "memory", "kept")
_OF_POINTS = ("v", "normal", "law", "mass", "nodes", "place", "u", "inverse_mass")
_RESULTS = ("value", "stress", "force", "tangent", "bend", "mixed")
GIVEN = np.dtype([(name, np.int64) for name in (*_OF_PARTICLES, *_OF_POINTS, *_RESULTS)])


@compiled
def nothing(*_):
    """Stand for hooks that an effect lacks; and in the patterns for those that it has."""


energy_hook = stress_hook = force_hook = tangent_hook = softening_hook = stress_change_hook = (
    nothing
)
force_change_hook = rate_stress_hook = relax_hook = nothing
contact_hook = touch_hook = drag_hook = node_hook = push_hook = nothing


@compiled
def _particles(given, count):
    """Arrays of what nearly all hooks of particles take: magnet, rho, x and F."""
    at = carray(given, 1)[0]
    return (
        carray(floats(at.magnet), (count, at.columns)),
        carray(floats(at.rho), (count,)),
        carray(floats(at.x), (count, 3)),
        carray(floats(at.F), (count, 3, 3)),
    )


# Particles one by one: at rest, and in motion those of effects that are not wide.


def energy(record, data, length, first, count, dt, given):
    """value += W, J/m^3."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    magnet, rho, x, F = _particles(given, count)
    value = carray(floats(carray(given, 1)[0].value), (count,))
    for p in range(count):
        value[p] += energy_hook(effect, table, magnet[p], rho[p], x[p], F[p])


def load(record, data, length, first, count, dt, given):
    """stress += dW/dF, and force -= dW/dx."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    magnet, rho, x, F = _particles(given, count)
    stress = carray(floats(carray(given, 1)[0].stress), (count, 3, 3))
    force = carray(floats(carray(given, 1)[0].force), (count, 3))
    for p in range(count):
        stress_hook(effect, table, magnet[p], rho[p], x[p], F[p], stress[p])
        force_hook(effect, table, magnet[p], rho[p], x[p], F[p], force[p])


def curvature(record, data, length, first, count, dt, given):
    """tangent += d2W/dF2; bend += d2W/dx2, and mixed += d2W/dx dF."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    magnet, rho, x, F = _particles(given, count)
    tangent = carray(floats(carray(given, 1)[0].tangent), (count, 9, 9))
    bend = carray(floats(carray(given, 1)[0].bend), (count, 3, 3))
    mixed = carray(floats(carray(given, 1)[0].mixed), (count, 3, 9))
    for p in range(count):
        tangent_hook(effect, table, magnet[p], rho[p], x[p], F[p], tangent[p])
        softening_hook(effect, table, magnet[p], rho[p], x[p], F[p], bend[p], mixed[p])


def load_change(record, data, length, first, count, dt, given):
    """stress and force += their changes with magnet and rho."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    magnet, rho, x, F = _particles(given, count)
    at = carray(given, 1)[0]
    dmagnet = carray(floats(at.dmagnet), (count, at.columns))
    drho = carray(floats(at.drho), (count,))
    stress = carray(floats(at.stress), (count, 3, 3))
    force = carray(floats(at.force), (count, 3))
    changed = np.empty(at.columns)
    less = np.empty((3, 3))
    pull = np.empty(3)
    for p in range(count):
        stress_change_hook(
            effect, table, magnet[p], rho[p], dmagnet[p], drho[p], x[p], F[p], stress[p]
        )
        force_change_hook(
            effect, table, magnet[p], rho[p], dmagnet[p], drho[p], x[p], F[p], force[p]
        )
        # of hooks without a change of their own: the difference, exact where they are linear
        less[:] = 0.0
        pull[:] = 0.0
        changed[:] = magnet[p] + dmagnet[p]
        stress_hook(effect, table, magnet[p], rho[p], x[p], F[p], less)
        stress_hook(effect, table, changed, rho[p] + drho[p], x[p], F[p], stress[p])
        force_hook(effect, table, magnet[p], rho[p], x[p], F[p], pull)
        force_hook(effect, table, changed, rho[p] + drho[p], x[p], F[p], force[p])
        stress[p] -= less
        force[p] -= pull


def rate_stress(record, data, length, first, count, dt, given):
    """stress += stress of the rates dF."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    _, rho, _, F = _particles(given, count)
    dF = carray(floats(carray(given, 1)[0].dF), (count, 3, 3))
    stress = carray(floats(carray(given, 1)[0].stress), (count, 3, 3))
    for p in range(count):
        rate_stress_hook(effect, table, rho[p], F[p], dF[p], stress[p])


# Particles in groups of eight lanes, in motion; count: of groups. What is the body's own begins at group `first`.


def wide_load(record, data, length, first, count, dt, given):
    """stress += dW/dF, and force -= dW/dx."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    for g in range(count):
        magnet = vector(floats(at.magnet), WIDTH * at.columns * (first + g))
        rho = lanes_at(floats(at.rho), WIDTH * (first + g))
        x = vector(floats(at.x), 3 * WIDTH * g)
        F = matrix(floats(at.F), 9 * WIDTH * g)
        stress = matrix(floats(at.stress), 9 * WIDTH * g)
        stress_hook(effect, table, magnet, rho, x, F, stress)
        force_hook(effect, table, magnet, rho, x, F, vector(floats(at.force), 3 * WIDTH * g))


def wide_rate_stress(record, data, length, first, count, dt, given):
    """stress += stress of the rates dF."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    for g in range(count):
        rho = lanes_at(floats(at.rho), WIDTH * (first + g))
        F = matrix(floats(at.F), 9 * WIDTH * g)
        dF = matrix(floats(at.dF), 9 * WIDTH * g)
        rate_stress_hook(effect, table, rho, F, dF, matrix(floats(at.stress), 9 * WIDTH * g))


def relax(record, data, length, first, count, dt, given):
    """stress += stress of what is remembered, which follows F for dt."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    for g in range(count):
        F = matrix(floats(at.F), 9 * WIDTH * g)
        memory = vector(floats(at.memory), WIDTH * at.kept * (first + g))
        relax_hook(effect, table, dt, F, memory, matrix(floats(at.stress), 9 * WIDTH * g))


# Points of the surface, and nodes.


def contact(record, data, length, first, count, dt, given):
    """Raise value, the largest depth (m) of points so far, to that in this obstacle; force += its pushes; count: of groups of eight."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    depth = floats(at.value)
    for g in range(count):
        mass = lanes_at(floats(at.mass), WIDTH * g)
        x = vector(floats(at.x), 3 * WIDTH * g)
        f = vector(floats(at.force), PARTS * WIDTH * g)
        found = contact_hook(effect, table, x, mass, f)
        store(depth, WIDTH * g, larger(found, lanes_at(depth, WIDTH * g)))


def touch(record, data, length, first, count, dt, given):
    """value += energy of points at rest, J, with their force and bend."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    x = carray(floats(at.x), (count, 3))
    mass = carray(floats(at.mass), (count,))
    value = carray(floats(at.value), (count,))
    force = carray(floats(at.force), (count, 3))
    bend = carray(floats(at.bend), (count, 3, 3))
    for p in range(count):
        value[p] += touch_hook(effect, table, x[p], mass[p], force[p], bend[p])


def drag(record, data, length, first, count, dt, given):
    """force (count, 3) += the drag of a fluid on pieces of the surface."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    law = carray(floats(at.law), (count, at.columns))
    x = carray(floats(at.x), (count, 3))
    normal = carray(floats(at.normal), (count, 3))
    v = carray(floats(at.v), (count, 3))
    force = carray(floats(at.force), (count, 3))
    for p in range(count):
        drag_hook(effect, table, law[p], x[p], normal[p], v[p], force[p])


def node(record, data, length, first, count, dt, given):
    """Change the velocities v of nodes, m/s."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    at = carray(given, 1)[0]
    nodes = carray(numbers(at.nodes), (count,))
    for k in range(count):
        n = 3 * nodes[k]
        place = row(floats(at.place), n)
        free = row(floats(at.inverse_mass), n)[0] > 0.0
        node_hook(effect, table, place, row(floats(at.u), n), row(floats(at.v), n), free, dt)


def push(record, data, length, first, count, dt, given):
    """value *= seconds for which forces push in a step, over dt; count is 1."""
    effect = carray(record, 1)[0]
    table = carray(data, length)
    seconds = carray(floats(carray(given, 1)[0].value), (count,))
    seconds[0] *= push_hook(effect, table, dt)


# Each pattern with the hooks that it calls: a C function is made of it for an effect that has one of them.
PATTERNS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "energy": (energy, ("energy",)),
    "load": (load, ("stress", "force")),
    "curvature": (curvature, ("tangent", "softening")),
    "load_change": (load_change, ("stress", "force", "stress_change", "force_change")),
    "rate_stress": (rate_stress, ("rate_stress",)),
    "wide_load": (wide_load, ("stress", "force")),
    "wide_rate_stress": (wide_rate_stress, ("rate_stress",)),
    "relax": (relax, ("relax",)),
    "contact": (contact, ("contact",)),
    "touch": (touch, ("touch",)),
    "drag": (drag, ("drag",)),
    "node": (node, ("node",)),
    "push": (push, ("push",)),
}
AT_REST = ("energy", "load", "curvature", "touch")
WIDE = ("relax", "wide_load", "wide_rate_stress")
NARROW = ("load", "rate_stress")
OF_STEPS = (*WIDE, *NARROW, "node", "push", "contact", "drag")


@inlined
def call_each(rows, step, first, count, dt, given):
    """Call the rows' functions for a step of dt (s), for `count` particles, groups, points or nodes from number `first` on.

    given: address of a record of GIVEN.
    """
    for k in range(len(rows)):
        record = rows[k, 1] + rows[k, 2] * min(step, rows[k, 3])
        call(rows[k, 0], (record, rows[k, 4], rows[k, 5], first, count, dt, given))


@inner
def given_for():
    """Room for the addresses of what hooks act on."""
    return np.zeros(1, GIVEN)


@inner
def particles_from(given, p, magnet, rho, x, F):
    """Give hooks the particles from number p on of magnet (n, columns), rho (n,), x (n, 3) and F (n, 3, 3)."""
    at = given[0]
    at.columns = magnet.shape[1]
    at.magnet = address(magnet, magnet.shape[1] * p)
    at.rho = address(rho, p)
    at.x = address(x, 3 * p)
    at.F = address(F, 9 * p)


@inner
def add_energies(rows, count, given, W):
    """Add the energies of the particles given to W (count,), J/m^3."""
    given[0].value = address(W, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@inner
def add_loads(rows, count, given, P, f):
    """Add the stresses and forces of the particles given to P (count, 3, 3) Pa and f (count, 3) N/m^3."""
    at = given[0]
    at.stress = address(P, 0)
    at.force = address(f, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@inner
def add_curvatures(rows, count, given, A, H, M):
    """Add the second derivatives of the particles given to A (count, 9, 9) Pa, H (count, 3, 3) N/m^4 and M (count, 3, 9) N/m^3."""
    at = given[0]
    at.tangent = address(A, 0)
    at.bend = address(H, 0)
    at.mixed = address(M, 0)
    call_each(rows, 0, 0, count, 0.0, address(given, 0))


@inner
def points_from(given, x, mass, value, f):
    """Give hooks the points x (n, 3) and mass (n,), with what they write to value (n,) and f."""
    at = given[0]
    at.x = address(x, 0)
    at.mass = address(mass, 0)
    at.value = address(value, 0)
    at.force = address(f, 0)


@inner
def pushes(rows, step, given, groups, x, layer, depth, f):
    """Write to depth (groups 8,) the largest depth (m) of points x (groups 3 8,) m in what acts: -inf without rows, or where that is
    unknown; and to f (groups PARTS 8,) the push of all. layer: an array with their mass, kg, and where it begins there."""
    depth[: WIDTH * groups] = -np.inf
    f[: PARTS * WIDTH * groups] = 0.0
    mass, first = layer
    points_from(given, x, mass, depth, f)
    given[0].mass = address(mass, first)
    call_each(rows, step, 0, groups, 0.0, address(given, 0))


@compiled_elsewhere
def pushes_on(rows, x, mass):
    """Depth (n,) m and push (n, PARTS), as of `pushes`, of points x (n, 3) m of mass (n,) kg."""
    groups = -(-len(x) // WIDTH)
    places = np.zeros((groups, 3, WIDTH))
    masses = np.zeros(WIDTH * groups)
    found = np.empty(WIDTH * groups)
    pushed = np.empty((groups, PARTS, WIDTH))
    for p in range(len(x)):
        masses[p] = mass[p]
        places[p // WIDTH, :, p % WIDTH] = x[p]
    pushes(rows, 0, given_for(), groups, places.reshape(-1), (masses, 0), found, pushed.reshape(-1))
    f = np.empty((len(x), PARTS))
    for p in range(len(x)):
        f[p] = pushed[p // WIDTH, :, p % WIDTH]
    return found[: len(x)], f


class Function(NamedTuple):
    """A C function of an effect: its pattern, the effect's module, and the field names of its records."""

    pattern: str
    module: str
    names: tuple[str, ...]

    def hooks(self) -> Plain:
        """The effect's functions that it calls, by hook. One that says how a hook changes takes the place of the hook."""
        found = hooks_of(self.names, PATTERNS[self.pattern][1])
        return {name: of for name, of in found.items() if f"{name}_change" not in found}

    def key(self) -> tuple[Any, ...]:
        """Its pattern and the functions that it calls: names may be registered again."""
        return (self.pattern, *self.hooks().values())


_ready: dict[Any, Any] = {}  # of this process


def prepare(functions: Sequence[Function]) -> None:
    """Load C functions, or compile those that are not on the disk, once in this process."""
    new = [one for one in dict.fromkeys(functions) if one.key() not in _ready]
    found = c_functions([(*_plain(one), C_OPTIONS, one) for one in new], compile_functions)
    _ready.update(zip([one.key() for one in new], found, strict=True))


def compile_functions(functions: Sequence[Function]) -> None:
    """Compile functions in a process that does that for others."""
    for one in functions:
        import_module(one.module)
    prepare(functions)


def _plain(function: Function) -> tuple[FunctionType, Any]:
    """The Python function that becomes a C function, and its signature."""
    pattern: Any = PATTERNS[function.pattern][0]
    hooks = function.hooks()
    dtype = dtype_of(function.names)
    codes = [of.py_func.__code__ for of in hooks.values()]
    about = [dtype.descr, *[(code.co_qualname, code.co_firstlineno) for code in codes]]
    stamp = sha256(str(about).encode()).hexdigest()[:8]
    name = f"{function.pattern}_of_{stamp}"
    # Numba's symbols and files are named by these; the file's times say whether what is on disk is outdated
    # and it reads their text from the line where it says that they begin: that of a hook
    code = pattern.__code__.replace(
        co_name=name,
        co_qualname=name,
        co_filename=codes[0].co_filename,
        co_firstlineno=codes[0].co_firstlineno,
    )
    space = {f"{hook}_hook": of for hook, of in hooks.items()}
    space |= {"__name__": function.module}
    return FunctionType(code, pattern.__globals__ | space, name), types.void(
        types.CPointer(numba.from_dtype(dtype)),
        types.CPointer(types.float64),
        types.intp,
        types.intp,
        types.intp,
        types.float64,
        types.CPointer(numba.from_dtype(GIVEN)),
    )


def functions_of(named: tuple[Any, ...], *patterns: str) -> list[tuple[Function, Any, Any]]:
    """The C functions of these patterns, with the records and the table of each."""
    return [
        (Function(pattern, module, records.dtype.names), records, data)
        for records, data in pairs(named)
        for pattern in patterns
        if (module := module_of(records.dtype.names, PATTERNS[pattern][1])) is not None
    ]


def in_steps(named: tuple[Any, ...], *patterns: str) -> list[tuple[Function, Any, Any]]:
    """`functions_of` in steps of a motion: of wide effects those in groups, of others those one by one."""
    return [
        found
        for found in functions_of(named, *patterns)
        if not (is_wide(found[0].names) and found[0].pattern in NARROW)
        and not (not is_wide(found[0].names) and found[0].pattern in WIDE[1:])
    ]


def rows(named: tuple[Any, ...], *patterns: str) -> Index:
    """Rows (k, 6) by which kernels call these patterns of what acts, as long as it is kept: address of the function; address and size of
    the records, and number of the last one; address and length of the table."""
    return _rows(functions_of(named, *patterns))


def _rows(found: Sequence[tuple[Function, Any, Any]]) -> Index:
    """`rows` of functions. Raises TypeError where records or table are not what machine code reads at their addresses."""
    prepare([function for function, _, _ in found])
    for function, records, data in found:
        if records.dtype != dtype_of(function.names) or not records.flags.c_contiguous:
            raise TypeError(
                f"{function.module}: records must be contiguous, of the dtype that is registered"
            )
        if data.dtype != np.float64 or data.ndim != 1 or not data.flags.c_contiguous:
            raise TypeError(f"{function.module}: the table must be a flat array of floats")
    return np.array(
        [
            (
                _ready[function.key()].address,
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
    """Rows for equilibria: energies of particles; their stresses and forces; second derivatives, and whether some are with place."""

    energy: Index
    load: Index
    curvature: Index
    softens: int


class MotionCalls(NamedTuple):
    """Rows for motion: of particles in groups and one by one, and whether one of them takes rates; of nodes; of points; of pieces in a
    fluid."""

    wide: Index
    narrow: Index
    rates: int
    node: Index
    push: Index
    contact: Index
    drag: Index


def at_rest(named: tuple[Any, ...]) -> RestCalls:
    """Rows for equilibria of what acts, as long as it is kept."""
    prepare(functions_at_rest(named))
    softens = int(has_hook("softening", named))
    return RestCalls(rows(named, "energy"), rows(named, "load"), rows(named, "curvature"), softens)


def in_motion(named: tuple[Any, ...]) -> MotionCalls:
    """Rows for motion of what acts, as long as it is kept."""
    prepare([function for function, _, _ in in_steps(named, *OF_STEPS)])
    return MotionCalls(
        wide=_rows(in_steps(named, *WIDE)),
        narrow=_rows(in_steps(named, *NARROW)),
        rates=int(has_hook("rate_stress", named)),
        node=rows(named, "node"),
        push=rows(named, "push"),
        contact=rows(named, "contact"),
        drag=rows(named, "drag"),
    )


def functions_at_rest(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that equilibria call."""
    return [function for function, _, _ in functions_of(named, *AT_REST)]


def functions_in_motion(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that a motion calls, in its steps and at its frames."""
    found = in_steps(named, *OF_STEPS) + functions_of(named, "energy", "load")
    return [function for function, _, _ in found]


def functions_of_changes(named: tuple[Any, ...]) -> list[Function]:
    """The functions of what acts that derivatives call."""
    return [function for function, _, _ in functions_of(named, "load", "load_change")]
