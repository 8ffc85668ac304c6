"""Settings that several commands share."""

from dataclasses import dataclass

from tactorch.config import Options, option


@dataclass(frozen=True, kw_only=True)
class CommandOptions(Options):
    """Settings of every command."""

    run_dir: str = option(
        "outputs/${hydra:job.name}/${now:%Y-%m-%d_%H-%M-%S}",
        "Folder of the results and the log",
    )


@dataclass(frozen=True, kw_only=True)
class UnitCheck(Options):
    """Setting of the commands that read files with numbers."""

    check_units: bool = option(True, "Refuse numbers that look like another unit")
