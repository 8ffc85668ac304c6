"""What kind of value each setting holds, so that a wrong one is refused by name."""

import math
from collections.abc import Callable, Container, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from tactorch.cli.catalog import Catalog
from tactorch.cli.error_messages import unknown_setting
from tactorch.errors import ConfigError

if TYPE_CHECKING:  # completion reads the tables below, and must not wait
    from omegaconf import DictConfig


class Kind(NamedTuple):
    """A kind of value: what messages call it, and the test for it."""

    name: str
    holds: Callable[[Any], bool]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_point(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


def _is_relabelling(value: Any) -> bool:
    return isinstance(value, Mapping) and all(map(_is_number, (*value.values(), *value.keys())))


def _is_list(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0


_NUMBER = Kind("a number", _is_number)
HOMOGENEOUS = "homogeneous"
_MODULUS = Kind(f"a number or {HOMOGENEOUS}", lambda v: v == HOMOGENEOUS or _is_number(v))
_WHOLE = Kind("a whole number", _is_whole)
_FLAG = Kind("true or false", lambda value: isinstance(value, bool))
_PRIOR_MEAN = Kind("true, false or auto", lambda v: isinstance(v, bool) or v == "auto")
_RECONSTRUCT = Kind("true, false or linear", lambda v: isinstance(v, bool) or v == "linear")
_TEXT = Kind("text", lambda value: isinstance(value, str))
# A file may be called 7.
_PATH = Kind("a path", lambda v: isinstance(v, str | int | float) and v is not True and v != "")
_PATHS = Kind("a list: [A,B]", lambda v: isinstance(v, list) and all(map(_PATH.holds, v)))
_NAMES = Kind("a list: [A,B]", lambda v: isinstance(v, list) and all(map(_TEXT.holds, v)))
FLAG, PATH, PATHS = _FLAG, _PATH, _PATHS  # which completion knows
_POINT = Kind("a list of three numbers: [X,Y,Z]", _is_point)
_POINTS = Kind(
    "a list of points: [[X,Y,Z],...]", lambda v: isinstance(v, list) and all(map(_is_point, v))
)
_NUMBERS = Kind(
    "a table of numbers: {NAME: NUMBER}",
    lambda v: isinstance(v, Mapping) and all(map(_is_number, v.values())),
)
_LEVELS = Kind("two moduli: [A,B]", _is_pair)
_RELABELLING = Kind("a table of moduli: {OLD: NEW}", _is_relabelling)

_RANGE = Kind("the ends of a range: [LOW,HIGH]", _is_pair)
_WHOLES = Kind("a list of whole numbers: [A,B]", lambda v: _is_list(v) and all(map(_is_whole, v)))
_SIDES = Kind(
    "a list of sets of sides: [[z+],[z+,x+]]", lambda v: _is_list(v) and all(map(_NAMES.holds, v))
)
_OFFSET = Kind("two numbers: [X,Y]", _is_pair)
_MODULI = Kind(
    "a number, or a list of numbers",
    lambda v: _is_number(v) or (_is_list(v) and all(map(_is_number, v))),
)
_SHARES = Kind("three shares: [TRAINING,VALIDATION,TEST]", lambda v: _is_point(v) and min(v) >= 0)
_DEVICES = Kind("a whole number or auto", lambda v: v == "auto" or _is_whole(v))
# By a setting's whole name, where its last part means something else elsewhere.
_WHOLE_NAMES: dict[Kind, str] = {
    _WHOLE: """
        dataset.count dataset.views dataset.shard phantom.count data.frames
        size.models.patches size.models.patch_steps size.recognition.count size.sampling.presses
    """,
    _OFFSET: "phantom.offset mm_per_px",
    _MODULI: "phantom.youngs_mpa",
    _SHARES: "data.shares",
    _DEVICES: "trainer.devices",
    _RANGE: """
        dataset.snr_db dataset.presses.p_max_mpa dataset.presses.load
        dataset.presses.patch_radius_mm dataset.poisson
    """,
    _WHOLES: "dataset.presses.steps dataset.presses.patches",
    _SIDES: "dataset.presses.faces",
}
#: Settings that belong to what is chosen by a name beside them, and are checked there.
_FREE = ("dataset.family.",)

# By the last part of a setting's name, which means the same wherever it stands.
_NAMES_OF: dict[Kind, str] = {
    _NUMBER: """
        lower upper relative mm max_seconds snr_db weight edge tolerance damping forcing ftol gtol
        poisson lame_factor noise_mm round_rest_m p_max_mpa spring_n_per_mm patch_radius_mm
        relative_edge_length edge_length_mm fine_edge_length_mm fine_relative
        noise_relative tnc_patience
        force_scale rest_scale translation_mm rotation_rad level_mpa length_mm deviation
        residual_model_error_fraction
        tikhonov smoothness total_variation log_jumps sparsity binary_well matern
        depth radius height side_mm diameter_mm height_mm youngs_mpa inclusion_mpa
        tube low_mpa high_mpa hole_mpa waist_mm rim_mm radius_mm ball distance median_mpa spread
        patch_share prior_share dropout learning_rate weight_decay gradient_clip max_minutes
        brightness ball_radius_mm marker_diameter_px magnify edge_mm around_mm min_depth_mm steep
        reach_mm depth_mm sensor_mm load
        poll_seconds patience_seconds update_seconds idle_seconds pause_seconds
    """,
    _MODULUS: "start_mpa",
    _WHOLE: """
        seed samples steps max_iterations max_evaluations stage_iterations cg_iterations memory
        max_trials workers max_epochs splits hidden layers voxels batch split patience
        width encoded cells held_out folds rounds reference_frames max_frames pictures
        min_frames divisions tnc_evaluations places epochs candidates
        max_batch max_iterations max_presses max_lumps
    """,
    _TEXT: """
        name misfit model_error element generator hold space hessian source weight_rule executor
        scheduler accelerator strategy precision part map
        first_touch untouched poses_clock held_side held_by unit exhibit colours rule
    """,
    _PATH: """
        path out recording run run_dir resume folder weights
        sensor images reference labels calibration frames poses replay recognizer
    """,
    _POINT: "center size radii axis size_mm origin_mm",
    _FLAG: "plots check_units as_they_end retry_failed card augment video backward uncertainty",
    _RECONSTRUCT: "reconstruct",
    _PRIOR_MEAN: "prior_mean",
    _PATHS: "compare",
    _NAMES: "faces names meshes",
    _POINTS: "patch_centers_mm",
    _NUMBERS: "parameters parts",
    _LEVELS: "levels_mpa",
    _RELABELLING: "relabel_truth",
}
KINDS = {
    name: kind
    for table in (_NAMES_OF, _WHOLE_NAMES)
    for kind, names in table.items()
    for name in names.split()
}
# Settings that may be null: not given, not wanted, or found by the program.
_OPTIONAL = """
    mm max_seconds snr_db weight edge_length_mm fine_edge_length_mm fine_relative noise_mm
    patch_radius_mm patch_centers_mm round_rest_m relabel_truth path out recording resume
    nuisance.poisson force_scale rest_scale translation_mm rotation_rad
    edge level_mpa levels_mpa workers scheduler patience gradient_clip max_minutes folder
    dataset.presses.load dataset.poisson weights recognizer
    reference labels mm_per_px marker_diameter_px held_out folds max_frames object.depth_mm
    idle_seconds update_seconds max_presses replay suggest.radius_mm
"""
OPTIONAL = frozenset(_OPTIONAL.split())


def check_settings(cfg: "DictConfig", catalog: Catalog, given: list[str]) -> None:
    """Refuse settings that are missing, unknown, or hold another kind of value than they should.

    Raises:
        ConfigError: names the setting and what to give.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        values = OmegaConf.to_container(cfg, resolve=True)
    except OmegaConfBaseException as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"a setting refers to what is not there: {reason}.") from error
    assert isinstance(values, dict)
    for name in values:
        if name not in {*catalog.settings, *catalog.defaults}:
            raise ConfigError(unknown_setting(str(name), catalog, given))
    for name in (*catalog.settings, *catalog.defaults):
        _check_presence(name, values.get(name, {}), catalog)
    for name, value in _leaves(values, groups=catalog.defaults):
        _check(name, value)


def _check_presence(name: str, value: Any, catalog: Catalog) -> None:
    default = catalog.settings.get(name)
    if default == "???" and value in (None, "???"):
        raise ConfigError(
            f"'{name}' is missing; give {name}=... (see tactorch {catalog.verb} --help)."
        )
    is_table = isinstance(default, Mapping) or name in catalog.defaults
    if is_table and not isinstance(value, Mapping):
        raise ConfigError(f"{name}={value!r}: it holds several settings; give {name}.KEY=VALUE.")


def _leaves(
    values: Mapping[Any, Any], prefix: str = "", groups: Container[str] = ()
) -> Iterator[tuple[str, Any]]:
    """Name and value of each setting; groups hold others, even where called like a setting."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and (str(key) not in KINDS or name in groups):
            yield from _leaves(value, f"{name}.")
        else:
            yield name, value


def kind_of(name: str) -> Kind | None:
    """Return what a setting holds, by its full name; None where what is beside it decides."""
    return None if name.startswith(_FREE) else KINDS.get(name, KINDS.get(name.split(".")[-1]))


def _check(name: str, value: Any) -> None:
    leaf, kind = name.split(".")[-1], kind_of(name)
    if kind is None or kind.holds(value):
        return
    optional = leaf in OPTIONAL or name in OPTIONAL
    if value is None and optional:
        return
    or_null = ", or null" if optional else ""
    raise ConfigError(f"{name}={value!r}: give {kind.name}{or_null}.")
