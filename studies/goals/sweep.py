"""Runs of a scene over values of its numbers: every combination, in processes, resumable, one row each.

Rows next to each other are a path, which one process follows: solves at rest begin from what those before them in the path have added to
their rods (statics.neighbors), in half the time. Paths know nothing of each other: it does not matter which process takes one, nor how many
there are. So rows are those of `run` to what the solver's tolerance leaves, and the same to the last bit for any number of processes.
"""

from __future__ import annotations

import hashlib
import json
import marshal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from types import CodeType
from typing import Any

from magmpm.compiled.arrays import Array
from magmpm.compiled.process import Died
from magmpm.errors import InputError, MagmpmError, in_one_line, require
from magmpm.inputs.settings import validate
from magmpm.results.folder_lock import folder_lock
from magmpm.rod.cantilever import is_cantilever
from magmpm.scene import Scene, load_scene
from magmpm.scene.addresses import changed, check_apart, places
from magmpm.statics.equilibrium import Following
from magmpm.statics.neighbors import Neighbors
from magmpm.studies.goals import Plain, evaluate
from magmpm.studies.goals.answer import Answer
from magmpm.studies.goals.evaluate import WHY
from magmpm.studies.goals.measures import KINDS, Measure
from magmpm.studies.goals.own_function import called, function_of, source_of
from magmpm.studies.search.knobs import accepted
from magmpm.studies.search.samplers.choice import check_workers

ROWS = "rows.jsonl"
TIP = "tip"


Functions = dict[str, Callable[[Any], Any]]  # of users, by the names of their columns
_Outcome = tuple[Plain, Any]  # measures, and a Result or Motion


@dataclass(frozen=True)
class SweepTable:
    """Rows of a sweep: what was set, then the measures in SI; `failed` says why a run, or some of its measures, are missing."""

    rows: list[Plain]

    def __repr__(self) -> str:
        columns = ", ".join(dict.fromkeys(key for row in self.rows for key in row))
        return f"SweepTable({len(self.rows)} rows of {columns})"

    def to_dataframe(self) -> Any:
        """A pandas DataFrame. Raises InputError where pandas is not installed."""
        require("pandas", "dataframe", key="to_dataframe", use="tables")
        from pandas import DataFrame

        return DataFrame(self.rows)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)


def sweep(
    scene: Scene | Path | str | Mapping[str, Any],
    values: Mapping[str, Sequence[Any] | Array],
    *,
    measure: Sequence[str | Mapping[str, Any] | Callable[[Any], Any]] = (TIP,),
    executor: Executor | None = None,
    workers: int | None = None,
    folder: Path | str | None = None,
    on_row: Callable[[Plain], None] | None = None,
    units: bool = False,
) -> SweepTable:
    """Run a scene for every combination of values of its numbers, and measure each answer.

    A row whose values the scene refuses is not run, and says why in `failed`.

    Parameters
    ----------
    scene : Scene, Path, str or Mapping[str, Any]
        A Scene, the path of its file, or a dict as load_scene takes.
    values : Mapping[str, Sequence[Any] or array]
        For each address of a number, such as "field.uniform[2]", the values that it takes: text
        with units, SI numbers, {} or None.
    measure : sequence of str, Mapping[str, Any] or callable, default (TIP,)
        "tip", names of measures (docs/goals.md), their settings as dicts, or functions of a
        Result (of the Motion of what runs along time) that return a number.
    executor : Executor, optional
        Any of concurrent.futures, Dask or MPI. None: `workers` processes of its own.
    workers : int, optional
        Number of these processes; one for each CPU unless given.
    folder : Path or str, optional
        Where rows are kept, and found again. None: nowhere.
    on_row : callable, optional
        Called with each new row.
    units : bool, default False
        Whether values must have units where those in a scene's file have, as on the command line.

    Returns
    -------
    SweepTable
        The rows, one for each combination, in SI.

    Raises
    ------
    InputError
        For wrong addresses and measures, a number of workers that can't be, and where the scene refuses every row, before the
        first run.

    Examples
    --------
    >>> import magmpm
    >>> scene = magmpm.load_scene("data/scenes/axial_transverse.yaml").with_cells(2)
    >>> table = magmpm.sweep(scene, {"field.uniform[2]": ["2 mT", "4 mT"]}, workers=1)
    >>> len(table)
    2
    """
    import os

    check_workers(workers)
    whole = scene if isinstance(scene, Scene) else load_scene(scene)
    beside = Path(scene).parent if isinstance(scene, (str, Path)) else Path()
    measures, functions = _measures(measure)
    for name, of in measures.items():
        if of.python:
            function_of(of.python, beside, f"measure.{name}")
    combined = _combined(whole, values, measures, units)
    keep = None if folder is None else Path(folder)
    with ExitStack() as stack:
        if keep is not None:
            keep.mkdir(parents=True, exist_ok=True)
            stack.enter_context(folder_lock(keep))
        known = _known(keep)
        work = Path(mkdtemp(prefix="magmpm-sweep-"))
        stack.callback(evaluate.forget, work)
        rows: dict[int, Plain] = {}
        keys: dict[int, str] = {}
        jobs: dict[int, evaluate.Job] = {}
        for k, (said, made) in enumerate(combined):
            if isinstance(made, InputError):
                rows[k] = {**said, WHY: in_one_line(made)}
                continue
            keys[k] = _key(made, measures, functions, beside)
            if keys[k] in known:
                rows[k] = {**said, **known[keys[k]]}
            else:
                jobs[k] = evaluate.Job(made, work / str(k), measures, beside)
        count = min(workers or os.cpu_count() or 1, len(jobs))
        if executor is None and count > 1:
            executor = stack.enter_context(evaluate.Processes(count))

        paths = _paths(jobs, len(combined))
        for k, outcome in _outcomes(jobs, paths, executor, bool(functions)):
            if isinstance(
                outcome, Died
            ):  # not kept: a run that the system killed may go through again
                evaluate.forget(jobs[k].folder)
                rows[k] = {**combined[k][0], WHY: f"the process that ran it {outcome}"}
                continue
            found, answer = outcome
            if answer is not None:
                own = {name: partial(called, of, answer, name) for name, of in functions.items()}
                both = [found, evaluate.known(own)]
                why = "; ".join(one.pop(WHY) for one in both if WHY in one)
                found = {**both[0], **both[1], **({WHY: why} if why else {})}
            evaluate.forget(jobs[k].folder)
            rows[k] = {**combined[k][0], **found}
            if keep is not None:
                with (keep / ROWS).open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps({"key": keys[k], "found": found}) + "\n")
            if on_row is not None:
                on_row(rows[k])
    return SweepTable([rows[k] for k in sorted(rows)])


def _measures(
    given: Sequence[str | Mapping[str, Any] | Callable[[Any], Any]],
) -> tuple[dict[str, Measure], Functions]:
    """Measures, and users' functions, each by the name of its column. Raises InputError."""
    measures: dict[str, Measure] = {}
    functions: Functions = {}
    for one in [given] if isinstance(given, (str, Mapping)) or callable(given) else given:
        if one == TIP:
            for axis, along in zip("xyz", ([1, 0, 0], [0, 1, 0], [0, 0, 1]), strict=True):
                position = {"of": TIP, "along": along}
                measures[f"tip_{axis}_m"] = validate(Measure, {"position": position})
            continue
        if isinstance(one, str) and one not in KINDS:
            raise InputError(
                "measure",
                received=repr(one),
                rule=f"must be tip, or one of {', '.join(KINDS)}",
                remedy="correct the name, or write its settings: {travel: {of: tip}}",
            )
        if callable(one):
            first = getattr(one, "__name__", type(one).__name__)
        else:
            found = validate(Measure, {one: {}} if isinstance(one, str) else one)
            first = found.name
        name = first
        k = 2
        while name in measures or name in functions:
            name, k = f"{first}_{k}", k + 1
        if callable(one):
            functions[name] = one
        else:
            measures[name] = found
    return measures, functions


def _combined(
    scene: Scene, values: Mapping[str, Any], measures: Mapping[str, Measure], units: bool
) -> list[tuple[Plain, Scene | InputError]]:
    """Every combination: what is set, and the scene, or why there is none that can be measured. Raises InputError where there is none."""
    values = {address: getattr(of, "tolist", lambda of=of: of)() for address, of in values.items()}
    for address, of in values.items():
        if isinstance(of, (str, bytes)) or not isinstance(of, Sequence) or not of:
            raise InputError(
                address,
                received=repr(of),
                rule="must be a list of values",
                remedy='write, say, ["2 mT", "4 mT"]',
            )
    at = {address: places(scene, address) for address in values}
    check_apart(at.items(), "values")
    found: list[tuple[Plain, Scene | InputError]] = []
    for chosen in product(*values.values()):
        said = dict(zip(values, chosen, strict=True))
        settings = {place: value for address, value in said.items() for place in at[address]}
        try:
            made = changed(scene, settings)
            for name, of in measures.items():
                of.check_moments(made, name)
        except InputError as error:
            found.append((said, error))
            continue
        if units:
            accepted(scene, settings, ", ".join(said), chosen[0] if len(chosen) == 1 else chosen)
        found.append((said, made))
    said, first = found[0]
    if all(isinstance(of, InputError) for _, of in found):
        words = ", ".join(f"{address} = {value}" for address, value in said.items())
        raise InputError(f"{words}: {str(first).removeprefix('input: ')}") from None
    return found


def _key(
    scene: Scene,
    measures: Mapping[str, Measure],
    functions: Functions,
    beside: Path,
) -> str:
    """Hash of all that decides a row, by which it is found again: of functions `_code`, of those in files the file."""
    codes = {name: _code(of) for name, of in functions.items()}
    files = [source_of(of.python, beside) for of in measures.values() if of.python]
    said = {name: of.model_dump(by_alias=True) for name, of in measures.items()}
    about = [scene.hash(), said, codes, files]
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()


def _code(of: Any, seen: set[CodeType] | None = None) -> str:
    """Text that differs between functions that may measure differently: by their code, by what it was made with, and by the globals that it
    names, functions among them."""
    code = getattr(of, "__code__", None)
    if code is None:
        return repr(getattr(of, "tolist", lambda: of)())  # all of an array's numbers
    seen = set() if seen is None else seen
    if code in seen:
        return ""
    seen.add(code)
    made_with = [cell.cell_contents for cell in of.__closure__ or ()]
    made_with += [of.__defaults__, of.__kwdefaults__]
    made_with += [of.__globals__.get(name) for name in _names(code)]
    return marshal.dumps(code).hex() + "".join(_code(one, seen) for one in made_with)


def _names(code: CodeType) -> list[str]:
    """Names that code looks up, and the code within it."""
    within = [one for one in code.co_consts if isinstance(one, CodeType)]
    return [*code.co_names, *(name for one in within for name in _names(one))]


def _known(folder: Path | None) -> dict[str, Plain]:
    """Rows that a folder has, by their keys; a last line that was cut off is none."""
    if folder is None or not (folder / ROWS).exists():
        return {}
    found = {}
    for line in (folder / ROWS).read_text(encoding="utf-8").splitlines():
        with suppress(ValueError):
            row = json.loads(line)
            found[row["key"]] = row["found"]
    return found


def _paths(jobs: Mapping[int, evaluate.Job], rows: int) -> list[list[int]]:
    """Numbers of the rows that are run, in paths: of equilibria of straight bodies up to eight neighbors, while there are as many paths."""
    longest = 8
    together = min(-(-rows // longest), longest)
    paths: dict[tuple[int, int], list[int]] = {}
    for k, job in jobs.items():
        scene = job.scene
        # errors that are requested take several grids, whose solves know each other
        alone = scene.in_time or scene.resolution.requested or not is_cantilever(scene)
        paths.setdefault((k // together, k if alone else -1), []).append(k)
    return list(paths.values())


def _outcomes(
    jobs: Mapping[int, evaluate.Job],
    paths: list[list[int]],
    executor: Executor | None,
    with_answer: bool,
) -> Iterator[tuple[int, _Outcome | Died]]:
    """The rows' numbers and outcomes as they come. Where a process ends, the rows of its path are run one by one."""
    if executor is None:
        for path in paths:
            yield from zip(path, _along([jobs[k] for k in path], with_answer), strict=True)
        return
    left: dict[Future[list[_Outcome]], list[int]] = {}
    while paths or left:
        for path in paths:
            left[executor.submit(_followed, [jobs[k] for k in path], with_answer)] = path
        paths = []
        for done in wait(left, return_when=FIRST_COMPLETED).done:
            path = left.pop(done)
            try:
                yield from zip(path, done.result(), strict=True)
            except Died as death:
                if len(path) > 1:
                    paths += [[k] for k in path]
                else:
                    yield path[0], death


def _followed(jobs: Sequence[evaluate.Job], with_answer: bool) -> list[_Outcome]:
    """The outcomes of a path, for another process."""
    return list(_along(jobs, with_answer))


def _along(jobs: Sequence[evaluate.Job], with_answer: bool) -> Iterator[_Outcome]:
    """The outcomes along a path: measures of a run, or why it failed; and its Result or Motion, where it is asked for.

    The stability of an equilibrium, a sixth of its time, is found where it is asked for, or may be.
    """
    from magmpm.simulate import RunOptions, simulated

    measures = jobs[0].measures.values()
    judged = with_answer or any(of.stability or of.python for of in measures)
    neighbors = Neighbors()
    following = Following(neighbors.expected, with_stability=judged)
    options = RunOptions(start=following if len(jobs) > 1 else None, judged=judged)
    for job in jobs:
        scene = job.scene
        try:
            if scene.in_time:
                answer = evaluate.answered(scene, job.folder)
            else:
                result = simulated(scene, options)
                neighbors.learn(result.grid_correction)
                answer = Answer(scene, result)
        except MagmpmError as error:
            yield {WHY: in_one_line(error)}, None
            continue
        found = evaluate.all_measured(job, answer, job.measures)
        yield found, answer.given if with_answer else None
