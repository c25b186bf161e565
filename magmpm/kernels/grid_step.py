"""The grid's step: forces and effects change the velocities of nodes, which move; where something rubs, friction comes between.

State and Nodes: kernels.total_lagrangian_step.
"""

import numpy as np

from magmpm.compiled.by_address import address
from magmpm.compiled.jit import inlined, inner, task_body
from magmpm.compiled.parallel import TOGETHER
from magmpm.effects.calls import call_each, given_for
from magmpm.kernels.body_contact import pace_of
from magmpm.kernels.mass_correction import added_at


@inlined
def push_node(k, push, nodes, correction, state):
    """v += push f / m of one active node, and no force; push: s for which forces push (effects.hooks)."""
    node = nodes.active[k]
    plane = correction.plane[k]
    n = 3 * node
    v = state.v
    force = state.force
    inverse_mass = nodes.inverse_mass
    for i in range(3):
        v[n + i] += push * (
            inverse_mass[n + i] * force[n + i] + added_at(correction, plane, node, i)
        )
        force[n + i] = 0.0


@inlined
def move_node(k, dt, nodes, meeting, state):
    """u += dt v of one active node. Returns the square of a bound on how fast (m/s) it lets a point of the body move."""
    n = 3 * nodes.active[k]
    for i in range(3):
        state.u[n + i] += dt * state.v[n + i]
    return pace_of(meeting, k, n, state.v)


@inner
def change_nodes(rows, first, last, step, dt, nodes, state):
    """Let effects change the velocities of active nodes from number `first` to before `last`."""
    given = given_for()
    at = given[0]
    at.nodes = address(nodes.active, first)
    at.place = address(nodes.place, 0)
    at.u = address(state.u, 0)
    at.v = address(state.v, 0)
    at.inverse_mass = address(nodes.inverse_mass, 0)
    call_each(rows, step, 0, last - first, dt, address(given, 0))


@inner
def push_time(calls, step, dt):
    """Seconds for which forces push in a step of dt (s)."""
    time = np.full(1, dt)
    given = given_for()
    given[0].value = address(time, 0)
    call_each(calls.push, step, 0, 1, dt, address(given, 0))
    return time[0]


@task_body
def update_grid(part, given):
    """Update some active nodes, and write to pace (parts,) the square of a bound on how fast (m/s) they let a point of the body move."""
    step, dt, push, nodes, correction, meeting, state, calls, pace = given
    first = TOGETHER * part
    last = min(first + TOGETHER, len(nodes.active))
    found = 0.0
    if len(calls.node) > 0:
        for k in range(first, last):
            push_node(k, push, nodes, correction, state)
        change_nodes(calls.node, first, last, step, dt, nodes, state)
        for k in range(first, last):
            found = max(found, move_node(k, dt, nodes, meeting, state))
    else:
        for k in range(first, last):
            push_node(k, push, nodes, correction, state)
            found = max(found, move_node(k, dt, nodes, meeting, state))
    pace[part] = found


@task_body
def push_nodes(part, given):
    """Update the velocities of some active nodes, as `update_grid` does."""
    step, dt, push, nodes, correction, state, calls = given
    first = TOGETHER * part
    last = min(first + TOGETHER, len(nodes.active))
    for k in range(first, last):
        push_node(k, push, nodes, correction, state)
    change_nodes(calls.node, first, last, step, dt, nodes, state)


@task_body
def move_nodes(part, given):
    """Finish `update_grid` of some active nodes after friction, with the correction of the mass for its forces.

    Effects change velocities once more, for no time: a guide's nodes go on as it moves, and damping takes nothing.
    """
    step, dt, push, nodes, correction, meeting, state, calls, pace = given
    first = TOGETHER * part
    last = min(first + TOGETHER, len(nodes.active))
    for k in range(first, last):
        node = nodes.active[k]
        for i in range(3):
            state.v[3 * node + i] += push * added_at(correction, correction.plane[k], node, i)
    change_nodes(calls.node, first, last, step, 0.0, nodes, state)
    found = 0.0
    for k in range(first, last):
        found = max(found, move_node(k, dt, nodes, meeting, state))
    pace[part] = found
