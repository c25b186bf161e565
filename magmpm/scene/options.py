"""Settings of a scene: materials, solver, resolution; with their rules. Bodies, fields and effects have theirs in their own rooms.

The descriptions and examples are what editors show (scene.schema.json) and what error messages quote.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from magmpm.compiled.arrays import Named, Plain
from magmpm.effects.contact_law import Friction
from magmpm.errors import quantity
from magmpm.inputs.messages import Instead, plain_word
from magmpm.inputs.quantities import KINDS, BadQuantity, parse_quantity
from magmpm.inputs.settings import (
    Bytes,
    Duration,
    Quantity,
    Settings,
    check_rising,
    fault,
    from_file,
    standing_for,
)
from magmpm.materials import STIFFEST, bulk_over_shear, poisson_ratio, shear_of_young

MOST_FRAMES_WRITTEN = 100_000


class Dynamic(Settings):
    """Motion in time by explicit steps.

    Parameters
    ----------
    duration : float or str, s
        How long the motion is followed.
    output_every : float or str, s, optional
        Time between frames on disk; a hundredth of the duration unless given.
    time_step : float or str, s, optional
        Time step; chosen below the stable bound unless given, and refused above it.
    safety : float, no unit, optional
        Chosen time step over the largest stable one; 0.8 unless given.
    max_disk : float or str, bytes, optional
        What the motion's files may take; all there is unless given.
    max_memory : float or str, bytes, optional
        What particles and grid may take in memory; all there is unless given.

    Examples
    --------
    >>> from magmpm import Dynamic
    >>> len(Dynamic(duration="0.5 s", output_every="5 ms").frame_times)
    100
    """

    duration: Annotated[float, Quantity("time", above="0 s", at_most="1e4 s")] = Field(
        description="How long the motion is followed.", examples=["0.5 s"]
    )
    output_every: Annotated[float, Quantity("time", above="0 s", at_most="1e4 s")] | None = Field(
        default=None,
        description="Time between frames on disk; a hundredth of the duration unless given.",
        examples=["5 ms"],
    )
    time_step: Annotated[float, Quantity("time", above="0 s", at_most="1 s")] | None = Field(
        default=None,
        description="Time step; chosen below the stable bound unless given, and refused above it.",
        examples=["10 us"],
    )
    safety: float = Field(
        default=0.8,
        gt=0,
        le=1,
        strict=True,
        allow_inf_nan=False,
        description="Chosen time step over the largest stable one; 0.8 unless given.",
        examples=[0.8],
    )
    max_disk: Bytes | None = Field(
        default=None,
        description="What the motion's files may take; all there is unless given.",
        examples=["2 GB"],
    )
    max_memory: Bytes | None = Field(
        default=None,
        description="What particles and grid may take in memory; all there is unless given.",
        examples=["4 GB"],
    )

    @model_validator(mode="before")
    @classmethod
    def _one_formulation(cls, given: Any, info: ValidationInfo) -> Any:
        if not isinstance(given, Mapping) or "formulation" not in given:
            return given
        if given["formulation"] not in (None, "total") or from_file(
            info
        ):  # results of earlier versions hold None or total
            rule = "there is one formulation of motion, total Lagrangian, so there is no such key"
            raise fault(rule, "leave it out", ("formulation",))
        return {key: value for key, value in given.items() if key != "formulation"}

    @model_validator(mode="after")
    def _frames_can_be_counted(self) -> Dynamic:
        frames = self.duration / (self.output_every or self.duration)
        if frames > MOST_FRAMES_WRITTEN * (1 + 1e-9):
            raise fault(
                f"a motion has at most {MOST_FRAMES_WRITTEN} frames, and this would have"
                f" {frames:.4g}",
                f"at least `output_every: {self.duration / MOST_FRAMES_WRITTEN:.3g} s`, or"
                " omit it for a "
                f"hundred frames, here `output_every: {10 * self.duration:.3g} ms`",
                ("output_every",),
            )
        return self

    @property
    def frame_interval(self) -> float:
        """Time between frames, s."""
        return self.output_every or self.duration / 100

    @property
    def frame_times(self) -> list[float]:
        """Times of the frames after the first, s: every `output_every`, and the end."""
        every = self.frame_interval
        times = [k * every for k in range(1, int(self.duration / every * (1 + 1e-12)) + 1)]
        return (
            times if times and times[-1] > self.duration * (1 - 1e-9) else [*times, self.duration]
        )


class QuasiStatic(Settings):
    """Equilibria along time, each found from the one before.

    Parameters
    ----------
    steps : int, optional
        Equal steps from 0 s to the end of the field's schedule, or of `duration`; give this or
        `at`.
    at : sequence of float or str, s, optional
        Times of the equilibria, rising; give this or `steps`.
    duration : float or str, s, optional
        With `steps`: when the last equilibrium is; the end of the field's schedule unless
        given.
    max_disk : float or str, bytes, optional
        What the files of all steps may take; all there is unless given.

    Examples
    --------
    >>> from magmpm import QuasiStatic
    >>> QuasiStatic(at=["0 s", "0.1 s", "0.15 s"]).at  # s
    (0.0, 0.1, 0.15)
    """

    steps: int | None = Field(
        default=None,
        strict=True,
        ge=1,
        le=MOST_FRAMES_WRITTEN - 1,
        description=(
            "Equal steps from 0 s to the end of the field's schedule, or of `duration`; give this"
            " or `at`."
        ),
        examples=[40],
    )
    at: tuple[Annotated[float, Quantity("time", at_least="0 s", at_most="1e6 s")], ...] | None = (
        Field(
            default=None,
            min_length=2,
            max_length=MOST_FRAMES_WRITTEN,
            description="Times of the equilibria, rising; give this or `steps`.",
            examples=[["0 s", "0.1 s", "0.15 s"]],
        )
    )
    duration: Duration | None = Field(
        default=None,
        description=(
            "With `steps`: when the last equilibrium is; the end of the field's schedule unless"
            " given."
        ),
        examples=["0.5 s"],
    )
    max_disk: Bytes | None = Field(
        default=None,
        description="What the files of all steps may take; all there is unless given.",
        examples=["2 GB"],
    )

    @field_validator("at")
    @classmethod
    def _rising(cls, times: tuple[float, ...] | None) -> tuple[float, ...] | None:
        check_rising(times or (), "times", "s")
        return times

    @model_validator(mode="after")
    def _one_way_to_say_when(self) -> QuasiStatic:
        if self.steps is None and self.at is None:
            raise fault("it must have `steps` or `at`", "write, say, `quasi_static: {steps: 40}`")
        if self.at is not None:
            for key in ("steps", "duration"):
                if getattr(self, key) is not None:
                    raise fault(
                        f"`at` says when the equilibria are, and so does `{key}`",
                        f"remove `at` or `{key}`",
                        (key,),
                    )
        return self

    def times(self, schedule_end: float) -> list[float]:
        """Times (s) of all equilibria. schedule_end: s, when everything in the field's schedule that ends has ended."""
        if self.at is not None:
            return list(self.at)
        assert self.steps is not None  # _one_way_to_say_when
        end = self.duration if self.duration is not None else schedule_end
        return [float(time) for time in np.linspace(0.0, end, self.steps + 1)]


MOST_RATIO = 10_000.0  # bulk over shear modulus
USUAL_RATIO = 20.0  # bulk over shear modulus of silicone, where nothing says another
_YOUNG = {
    "young",
    "youngs",
    "young_modulus",
    "youngs_modulus",
    "elastic_modulus",
    "elasticity_modulus",
    "modulus_of_elasticity",
    "tensile_modulus",
    "e_modulus",
    "e",
    "modulus",
    "stiffness",
}
_POISSON = {"poisson", "poissons", "poisson_ratio", "poissons_ratio", "poisson_number", "nu"}
_BULK = {"bulk", "bulk_modulus", "compression_modulus", "k"}
_MAGNETIZATION = {
    "magnetization",
    "magnetisation",
    "remanent_magnetization",
    "remanent_magnetisation",
    "residual_magnetization",
    "residual_magnetisation",
    "saturation_magnetization",
    "saturation_magnetisation",
    "m",
    "mr",
    "m_r",
    "ms",
}
_REMANENCE = {
    "br",
    "b_r",
    "remanent_flux_density",
    "residual_flux_density",
    "remanent_induction",
    "residual_induction",
    "remenance",
}


def _number(values: Named, names: set[str], kind: str | None = None) -> float | None:
    """The positive number (SI) that stands under one of these names, text with a unit where it has a kind; None where none does."""
    for key, value in values.items():
        if plain_word(str(key)) not in names or isinstance(value, bool):
            continue
        try:
            read = (
                parse_quantity(value, KINDS[kind])
                if kind is not None and isinstance(value, str)
                else float(value)
            )
        except (BadQuantity, TypeError, ValueError):
            continue
        if 0.0 < read < np.inf:
            return read
    return None


def _shear_modulus(values: Named) -> str:
    """Text to write for Young's modulus."""
    formula = "G = E/(2 (1 + nu))"
    young = _number(values, _YOUNG, "pressure")
    nu = _number(values, _POISSON)
    if nu is None or not nu < 0.5:
        ratio = _number(values, {"bulk_to_shear"}) or USUAL_RATIO
        nu = poisson_ratio(1.0, ratio)
        source = f"nu = {poisson_ratio(1.0, ratio):.4g}, which is bulk_to_shear {ratio:g}"
    else:
        source = f"nu = {nu:g}"
    if young is None:
        return (
            f"write shear_modulus in its place; of Young's modulus, {formula} with {source}:"
            f" {shear_of_young(1.0, nu):.4g} E"
        )
    shear = quantity(shear_of_young(young, nu), "Pa", 4)
    return (
        f"write `shear_modulus: {shear}` in its place: of Young's modulus, {formula} with {source}"
    )


def _bulk_to_shear(values: Named, *, of_modulus: bool) -> str:
    """Text to write for Poisson's ratio, or for the bulk modulus."""
    if of_modulus:
        bulk = _number(values, _BULK, "pressure")
        shear = _number(values, {"shear_modulus"}, "pressure")
        known = bulk is not None and shear is not None
        write = f"`bulk_to_shear: {bulk / shear:.4g}`" if known else "bulk_to_shear"  # type: ignore[operator]
        return f"write {write} in its place: the bulk over the shear modulus, K/G"
    formula = "K/G = 2 (1 + nu)/(3 (1 - 2 nu))"
    nu = _number(values, _POISSON)
    if nu is None or not nu < 0.5 or not bulk_over_shear(nu) <= MOST_RATIO:
        usual = poisson_ratio(1.0, USUAL_RATIO)
        return (
            f"write bulk_to_shear in its place: {formula}, at most {MOST_RATIO:g}; the usual"
            f" {USUAL_RATIO:g} is nu = {usual:.4g}"
        )
    return f"write `bulk_to_shear: {bulk_over_shear(nu):.4g}` in its place: {formula}"


def _remanence(value: Any) -> str:
    """Text to write for a magnetization: its size by the remanence, its direction where the body has it."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        value = f"{value!r} A/m"
    if not isinstance(value, str):
        return (
            "a material has a remanence; its direction belongs to a segment or part: write "
            "`magnetization: [1, 0, 0]` there"
        )
    try:
        found = parse_quantity(value, KINDS["flux density"])
    except BadQuantity as error:
        write = (
            "remanence" if error.meant is None else f"`remanence: {quantity(error.meant, 'T', 4)}`"
        )
        return f"write {write} in its place: mu0 M for a magnetization M; 100 kA/m is 125.7 mT"
    return f"write `remanence: {quantity(found, 'T', 4)}` in its place"


class Material(Settings):
    """A material of the body, magnetic or plain: a silicone, or as stiff as a metal.

    Parameters
    ----------
    model : {'neo-hookean'}, optional
        Elastic law; neo-hookean unless given.
    shear_modulus : float or str, Pa
        Shear modulus G at small strain.
    bulk_to_shear : float, no unit
        Bulk over shear modulus, K/G: how incompressible. 20 is usual for silicone; above 2/3,
        so that Poisson's ratio (3K - 2G)/(6K + 2G) is positive, and at most 10000.
    density : float or str, kg/m^3, optional
        Mass per volume; needed for gravity.
    remanence : float or str, T, optional
        Remanent flux density Br; 0 mT, plain silicone, unless given.
    magnetization_law : {'stretches', 'rotates'}, optional
        Magnetization of the deformed material: F Br, which stretches with it (unless given), or
        R Br, which only rotates.
    friction : float, no unit, optional
        Coulomb's coefficient of friction of its surface, in place of the one that ground, walls
        or self_contact names. Of two parts that touch, and both name one, the smaller counts.

    Examples
    --------
    >>> from magmpm import Material
    >>> silicone = Material(shear_modulus="120 kPa", bulk_to_shear=20, remanence="138 mT")
    >>> silicone.shear_modulus, silicone.remanence  # Pa, T
    (120000.0, 0.138)
    """

    model: Literal["neo-hookean"] = Field(
        default="neo-hookean",
        description="Elastic law; neo-hookean unless given.",
        examples=["neo-hookean"],
    )
    shear_modulus: Annotated[float, Quantity("pressure", above="0 kPa", at_most=STIFFEST)] = Field(
        description="Shear modulus G at small strain.", examples=["120 kPa"]
    )
    bulk_to_shear: float = Field(
        strict=True,
        allow_inf_nan=False,
        description=(
            "Bulk over shear modulus, K/G: how incompressible. 20 is usual for silicone; above "
            "2/3, so that Poisson's ratio (3K - 2G)/(6K + 2G) is positive, and at most 10000."
        ),
        examples=[20],
        json_schema_extra={"exclusiveMinimum": 0.6667, "maximum": 10_000},
    )
    density: (
        Annotated[float, Quantity("density", above="0 kg/m^3", at_most="30000 kg/m^3")] | None
    ) = Field(
        default=None, description="Mass per volume; needed for gravity.", examples=["1882 kg/m^3"]
    )
    remanence: Annotated[float, Quantity("flux density", at_least="0 mT", at_most="3 T")] = Field(
        default=0.0,
        description="Remanent flux density Br; 0 mT, plain silicone, unless given.",
        examples=["138 mT"],
    )
    magnetization_law: Literal["stretches", "rotates"] = Field(
        default="stretches",
        description=(
            "Magnetization of the deformed material: F Br, which stretches with it (unless given),"
            " or R Br, which only rotates."
        ),
        examples=["rotates"],
    )

    friction: Friction | None = Field(
        default=None,
        description=(
            "Coulomb's coefficient of friction of its surface, in place of the one that ground,"
            " walls or self_contact names. Of two parts that touch, and both name one, the smaller"
            " counts."
        ),
        examples=[0.05],
    )

    @model_serializer(mode="wrap")
    def _as_said(self, handler: SerializerFunctionWrapHandler) -> Plain:
        """Plain data, with the law of magnetization and friction only where they are not the usual ones."""
        data: Plain = handler(self)
        usual = {"magnetization_law": "stretches", "friction": None}
        return {
            key: value for key, value in data.items() if key not in usual or value != usual[key]
        }

    @staticmethod
    def by_other_keys(key: str, values: Named) -> Instead | None:
        """The constants that papers and data sheets give, by those that are written here, with their numbers."""
        word = plain_word(key)
        value = values.get(key)
        if word in _YOUNG:
            return Instead(_shear_modulus(values), "shear_modulus")
        if word in _POISSON or word in _BULK:
            return Instead(_bulk_to_shear(values, of_modulus=word in _BULK), "bulk_to_shear")
        if word in _MAGNETIZATION or word in _REMANENCE:
            return Instead(_remanence(value), "remanence")
        return None

    @field_validator("bulk_to_shear")
    @classmethod
    def _nearly_incompressible(cls, ratio: float) -> float:
        if not 2 / 3 < ratio <= MOST_RATIO:
            raise fault(
                "must be greater than 2/3 (Poisson's ratio above 0) and at most 10000 (below"
                " 0.49995)",
                "write, say, `bulk_to_shear: 20`",
            )
        return ratio


_ERROR = {
    "type": "string",
    "title": "share of the length, or length",
    "examples": ["1 %", "0.1 mm"],
}


class Static(Settings):
    """Equilibrium: how it is sought.

    Parameters
    ----------
    tolerance : float, no unit, optional
        Stop when a step can lower the energy by less than this fraction; 1e-11 unless
        given.
    max_steps : int, optional
        Maximum number of Newton steps in a solve; 60 unless given. STL parts, which
        have no rod's shape to start from, get ten times this.
    field_steps : int, optional
        Steps in which field and gravity grow from zero; chosen by the solver unless given.

    Examples
    --------
    >>> from magmpm import Static
    >>> Static(field_steps=4).max_steps
    60
    """

    tolerance: float = Field(
        default=1e-11,
        strict=True,
        ge=1e-14,
        le=1e-2,
        allow_inf_nan=False,
        description=(
            "Stop when a step can lower the energy by less than this fraction; 1e-11 unless given."
        ),
        examples=[1e-11],
    )
    max_steps: int = Field(
        default=60,
        strict=True,
        ge=1,
        le=10_000,
        description=(
            "Maximum number of Newton steps in a solve; 60 unless given. STL parts, which have "
            "no rod's shape to start from, get ten times this."
        ),
        examples=[60],
    )
    field_steps: int | None = Field(
        default=None,
        strict=True,
        ge=1,
        le=1000,
        description=(
            "Steps in which field and gravity grow from zero; chosen by the solver unless given."
        ),
        examples=[10],
    )


class Solver(Settings):
    """Statics, quasi-statics or dynamics, one of them, and the settings that all share."""

    anti_locking: Literal["f-bar", "none"] = Field(
        default="f-bar",
        description=(
            "Treatment of volumetric locking, in equilibrium and in motion: f-bar (unless given) "
            "or none."
        ),
        examples=["f-bar"],
    )
    static: Static = Field(
        default=Static(),
        description=(
            "Equilibrium: {} for the usual settings; give this, `quasi_static` or `dynamic`."
        ),
        examples=[{}],
    )
    dynamic: Dynamic | None = Field(
        default=None,
        description=(
            "Motion in time, from rest: at least {duration: 0.5 s}; give this, `quasi_static` or"
            " `static`."
        ),
        examples=[{"duration": "0.5 s", "output_every": "5 ms"}],
    )
    quasi_static: QuasiStatic | None = Field(
        default=None,
        description=(
            "Equilibria along time, each from the one before: {steps: 40}; give this, `dynamic` or"
            " `static`."
        ),
        examples=[{"steps": 40}],
    )

    @model_validator(mode="before")
    @classmethod
    def _of_options(cls, data: Any) -> Any:
        """Options made in Python stand for the solver with their key."""
        return standing_for(
            data, {Static: "static", Dynamic: "dynamic", QuasiStatic: "quasi_static"}
        )

    @model_validator(mode="after")
    def _one_solver(self, info: ValidationInfo) -> Solver:
        """One kind of solve has no use for the settings of another; plain SI data hold all three, with the usual settings of statics."""
        given = [key for key in ("quasi_static", "dynamic") if getattr(self, key) is not None]
        if "static" in self.model_fields_set and (from_file(info) or self.static != Static()):
            given.insert(0, "static")
        if len(given) > 1:
            raise fault(
                "give `static`, `quasi_static` or `dynamic`, one of them: a scene is solved for"
                " its equilibrium, for equilibria along time, or for its motion; this has"
                f" {' and '.join(f'`{key}`' for key in given)}",
                (
                    "remove one of them; `anti_locking`, which applies to all of them, goes "
                    "beside them in `solver`"
                ),
            )
        return self


def _read_error(value: Any, info: ValidationInfo) -> float | str:
    """An error as a share of the length (float, no unit), or a length as text in SI ("0.0001 m"): both are read back as they are."""
    try:
        return Quantity("percentage").read(value, info)
    except PydanticCustomError:
        if not isinstance(value, str):
            raise fault(
                "an error is a share of the length, or a length, and needs its unit",
                'write, say, "1 %", or "0.1 mm"',
            ) from None
        si = Quantity("length", above="0 mm", at_most="10 m").read(value, info)
        return f"{si!r} m"


class Resolution(Settings):
    """Fineness of the grid: given in cells, or chosen for an error or a time.

    Parameters
    ----------
    cells_across : int, optional
        Grid cells across a catheter's diameter, a strip's thickness, or the thinnest part; 4
        unless given.
    particles_per_cell : int, optional
        Particles in a cell along each direction; 2 unless given; one point can't carry a cell's
        second moments.
    from_tip : True, optional
        Cells are counted from the tip, so that they stay in the material while the inserted
        length changes; the one at the base takes the rest. Unless given, all cells between
        two materials are equal.
    error : float or str, optional
        The largest allowed error, a share of the length or a length: the program
        chooses the cells, and bounds the error; give this, `seconds`, or cells_across.
    of : {'centreline', 'tip'}, optional
        Where `error` is meant: anywhere on the centreline (unless given), or at the tip.
    seconds : float or str, s, optional
        The best answer within this time, with its error: the program chooses the cells; give
        this, `error`, or cells_across.

    Examples
    --------
    >>> from magmpm import Resolution
    >>> Resolution(error="1 %").allowed(0.04)  # m, of a body of 0.04 m
    0.0004
    """

    cells_across: int = Field(
        default=4,
        strict=True,
        ge=2,
        le=16,
        description=(
            "Grid cells across a catheter's diameter, a strip's thickness, or the thinnest part; 4"
            " unless given."
        ),
        examples=[4],
    )
    particles_per_cell: int = Field(
        default=2,
        strict=True,
        ge=2,
        le=4,
        description=(
            "Particles in a cell along each direction; 2 unless given; one point can't carry a"
            " cell's second moments."
        ),
        examples=[2],
    )
    from_tip: Literal[True] | None = Field(
        default=None,
        description=(
            "Cells are counted from the tip, so that they stay in the material while the inserted"
            " length changes; the one at the base takes the rest. Unless given, all cells"
            " between two materials are equal."
        ),
        examples=[True],
    )
    error: Annotated[float | str, BeforeValidator(_read_error), WithJsonSchema(_ERROR)] | None = (
        Field(
            default=None,
            description=(
                "The largest allowed error, a share of the length or a length: the program "
                "chooses the cells, and bounds the error; give this, `seconds`, or cells_across."
            ),
            examples=["1 %", "0.1 mm"],
        )
    )
    of: Literal["centreline", "tip"] = Field(
        default="centreline",
        description=(
            "Where `error` is meant: anywhere on the centreline (unless given), or at the tip."
        ),
        examples=["tip"],
    )
    seconds: Annotated[float, Quantity("time", above="0 s", at_most="86400 s")] | None = Field(
        default=None,
        description=(
            "The best answer within this time, with its error: the program chooses the cells; give"
            " this, `error`, or cells_across."
        ),
        examples=["2 s"],
    )

    @field_validator("error")
    @classmethod
    def _error_is_one(cls, error: float | str | None) -> float | str | None:
        most_error = 0.5  # of the length: more is no answer at all
        if isinstance(error, float) and not 0.0 < error <= most_error:
            raise fault(
                f"must be greater than 0 and at most {100 * most_error:g} % of the length",
                f"this reads as {100 * error:.4g} %; write, say, 1 %",
            )
        return error

    @model_validator(mode="after")
    def _one_wish(self) -> Resolution:
        """Cells, an error or a time: one of them decides."""
        given = [
            key
            for key in ("cells_across", "error", "seconds")
            if key in self.model_fields_set and getattr(self, key) is not None
        ]
        if len(given) > 1:
            raise fault(
                "give `cells_across`, `error` or `seconds`, one of them: each decides how fine the"
                " grid is; this has"
                f" {' and '.join(f'`{key}: {getattr(self, key)}`' for key in given)}",
                f"remove {' or '.join(f'`{key}`' for key in given)}",
                (given[-1],),
            )
        if "of" in self.model_fields_set and self.of != "centreline" and not self.requested:
            raise fault(
                "`of` says where an error is meant, and no error is given",
                "add, say, `error: 0.1 mm`, or remove it",
                ("of",),
            )
        return self

    @model_serializer(mode="wrap")
    def _as_said(self, handler: SerializerFunctionWrapHandler) -> Plain:
        """Plain data without what is not said: chosen cells are none yet, and requested errors are reported only where there are any."""
        data: Plain = handler(self)
        left_out = ("cells_across",) if self.requested else ("error", "of", "seconds")
        return {
            key: value for key, value in data.items() if key not in left_out and value is not None
        }

    @property
    def requested(self) -> bool:
        """True if an error or a time is requested, so that the cells must be chosen before anything can be built (statics.resolution)."""
        return self.error is not None or self.seconds is not None

    def allowed(self, length: float) -> float | None:
        """The error requested, m, of a body of this length (m); None where none is."""
        if self.error is None:
            return None
        return (
            self.error * length
            if isinstance(self.error, float)
            else float(self.error.removesuffix(" m"))
        )
