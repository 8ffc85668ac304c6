"""`tactorch evaluate-model`: evaluate a trained network, in numbers and pictures.

    tactorch evaluate-model run=outputs/train/RUN
    tactorch evaluate-model run=outputs/train/RUN folder=data/recognition_noisy

The run folder gets scores.json, calibration.png and examples.png, and for a recognizer
confusion.png. A run of several splits is evaluated on the test part of each.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from tactorch.cli.compose import saved_options
from tactorch.cli.networks import make_data, make_model, model_name
from tactorch.cli.options import CommandOptions
from tactorch.cli.outputs import write_json
from tactorch.cli.settings import run_folder
from tactorch.cli.train import TrainOptions, check_data, read_data
from tactorch.config import option
from tactorch.errors import ConfigError
from tactorch.files import require_folder


@dataclass(frozen=True, kw_only=True)
class EvaluateModelOptions(CommandOptions):
    """Settings of the command."""

    run: Path = option(help="Run folder of `tactorch train`")
    folder: Path | None = option(
        None, "Another dataset to evaluate on, all of it; null: the run's own"
    )
    part: Literal["train", "val", "test"] = option("test", "Part of the run's own dataset")


def run(options: EvaluateModelOptions) -> dict[str, Any]:
    """Evaluate a trained network; writes numbers and pictures."""
    place = require_folder(options.run, "run to evaluate")
    trained: TrainOptions = saved_options("train", place)
    results = [_load_split(trained, place, n, options) for n in range(trained.splits)]
    if model_name(trained) == "recognizer":
        from tactorch.cli.evaluate_recognizer import evaluate
    else:
        from tactorch.cli.evaluate_surrogate import evaluate
    scores = evaluate(results, run_folder())
    write_json(run_folder() / "scores.json", scores)
    return scores


def _load_split(
    trained: TrainOptions, place: Path, number: int, options: EvaluateModelOptions
) -> tuple[Any, Any, str, dict[str, Any]]:
    """Return a split's network, its data, the part to evaluate on, and the stored facts.

    The data are the run's own, or all of another dataset.
    """
    part: str = options.part
    if options.folder is not None:
        data = replace(trained.data, folder=options.folder, shares=(0.0, 0.0, 1.0))
        trained, part = replace(trained, data=data), "test"
    module = make_data(trained, number)
    own = place if trained.splits == 1 else place / f"split-{number:02d}"
    facts = read_data(own)
    if options.folder is None:
        check_data(own, module)
    if not module.parts[part]:
        raise ConfigError(f"part={part} of the run's dataset is empty; choose another.")
    return _network(trained, module, facts, own), module, part, facts


def _network(trained: TrainOptions, data: Any, facts: dict[str, Any], own: Path) -> Any:
    """Return the best network of a run."""
    from tactorch.learning.training import BEST, load_weights

    if model_name(trained) == "surrogate":  # refuses weights of an older version of its input
        from tactorch.learning.surrogate.network import load_surrogate

        return load_surrogate(own / BEST)
    model = make_model(trained, data, facts)
    load_weights(model, own / BEST)
    return model.eval()
