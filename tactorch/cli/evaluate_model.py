"""`tactorch evaluate-model`."""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from tactorch.cli.networks import data_of, model_of
from tactorch.cli.outputs import write_json
from tactorch.cli.settings import folder
from tactorch.cli.train import check_data, read_data
from tactorch.errors import ConfigError, FileError
from tactorch.files import require_file, require_folder
from tactorch.learning.splits import PARTS


def run(cfg: DictConfig) -> dict[str, Any]:
    """Judge a trained network; writes numbers and pictures."""
    if cfg.part not in PARTS:
        raise ConfigError(f"part={cfg.part}: choose one of {', '.join(PARTS)}.")
    place = require_folder(str(cfg.run), "run to judge")
    trained = _settings(place)
    judged = [_trained(trained, place, n, cfg.folder, cfg.part) for n in range(trained.splits)]
    if trained.model.name == "recognizer":
        from tactorch.cli.judge_recognizer import judge
    else:
        from tactorch.cli.judge_surrogate import judge
    result = judge(judged, folder())
    write_json(folder() / "scores.json", result)
    return result


def _settings(place: Path) -> DictConfig:
    path = require_file(place / ".hydra" / "config.yaml", "settings of the run to judge")
    try:
        settings = OmegaConf.load(path)
        if not isinstance(settings, DictConfig):
            raise ValueError("no settings")
        names = (settings.model.name, settings.data.name, settings.data.folder, settings.seed)
        if settings.splits < 1 or any(name is None for name in names):
            raise ValueError("a setting is missing")
    # What a damaged YAML file raises has no common base.
    except Exception as error:
        raise FileError(
            f"'{path}' is no settings of a run of `tactorch train`"
            f" ({' '.join(str(error).split())[:120]}); give the folder of such a run."
        ) from error
    return settings


def _trained(
    trained: DictConfig, place: Path, number: int, other: str | None, part: str
) -> tuple[Any, Any, str, dict[str, Any]]:
    """Return a split's network, data, the part to judge it on, and what the run noted of its data.

    The data are the run's own, or all of another dataset.
    """
    settings = trained.copy()
    if other is not None:
        settings.data = {**settings.data, "folder": str(other), "shares": [0.0, 0.0, 1.0]}
        part = "test"
    data = data_of(settings, number)
    own = place if trained.splits == 1 else place / f"split-{number:02d}"
    known = read_data(own)
    if other is None:
        check_data(own, data)
    if not data.parts[part]:
        raise ConfigError(f"part={part} of the run's dataset is empty; choose another.")
    return _network(settings, data, known, own), data, part, known


def _network(settings: DictConfig, data: Any, known: dict[str, Any], own: Path) -> Any:
    """Return the best network of a run."""
    from tactorch.learning.training import BEST, load_weights

    if settings.model.name == "surrogate":  # refuses weights for what is no longer shown
        from tactorch.learning.surrogate.weights import load_surrogate

        return load_surrogate(own / BEST)
    model = model_of(settings, data, known)
    load_weights(model, own / BEST)
    return model.eval()
