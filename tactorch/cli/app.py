"""One command as a Hydra app, whose every error is one message on standard error."""

import argparse
import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from tactorch.cli import console
from tactorch.cli.compose import SEARCH_PACKAGE, build_options, store_config
from tactorch.cli.existing import (
    CONTINUING,
    WRITING_FOLDERS,
    Replaced,
    check_file,
    check_run_folder,
)
from tactorch.cli.overrides import (
    check_overrides,
    check_required,
    expanded,
    key_of,
    named,
    swept,
)
from tactorch.cli.resume import has_state, with_resume
from tactorch.cli.schema import command_module, load_schema
from tactorch.cli.starting import STARTED
from tactorch.cli.sweep import Job, register_names, summarize
from tactorch.config.targets import trust
from tactorch.errors import ConfigError, FileError, TactorchError
from tactorch.progress import progress_line
from tactorch.text import printable

if TYPE_CHECKING:
    from omegaconf import DictConfig

_DEBUG = "HYDRA_FULL_ERROR"
#: Flags that are not Hydra's.
_OWN_FLAGS = ("config_dir", "trust_config_dir", "trust")


class App:
    """A command with its settings; Hydra calls `job`, once or, in a sweep, for each combination.

    Flags and settings are checked before Hydra composes them.
    """

    def __init__(self, command: str, words: Sequence[str]) -> None:
        self.command = command
        flags, settings = _read_flags(command, expanded(command, named(command, words)))
        self._schema = load_schema(command)
        trust(*flags.trust)
        hydra_flags = {name: f for name, f in vars(flags).items() if name not in _OWN_FLAGS}
        if flags.config_dir and flags.trust_config_dir:  # Hydra composes it, whatever it holds
            if any(key_of(word) == "resume" for word in settings):
                raise ConfigError("resume takes plain settings; leave out --trust-config-dir.")
            hydra_flags["config_dir"] = flags.config_dir
            self._schema.check(self._schema.choices(settings))
        else:
            if flags.config_dir:
                self._schema.add_folder(Path(flags.config_dir))
            settings = check_overrides(self._schema, settings, multirun=flags.multirun)
            settings = with_resume(self._schema, settings, multirun=flags.multirun)
            if not (flags.cfg or flags.hydra_help or flags.info):
                check_required(self._schema, settings)
                check_run_folder(command, settings)
        self._is_only_shown = bool(flags.cfg or flags.hydra_help or flags.info)
        self._swept = swept(self._schema, settings) if flags.multirun else set()
        self._unnamed = {key_of(word) for word in settings} - self._swept
        self._jobs: list[Job] = []
        for name, value in hydra_flags.items():
            if value:
                settings += [f"--{name.replace('_', '-')}", *([] if value is True else [value])]
        self._arguments = settings
        self._started, self._failures = False, 0
        self._place: Path | None = None
        self._outputs: set[Path] = set()

    def run(self) -> None:
        """Let Hydra compose the settings and call `job`; ends the process on errors.

        Meanwhile the process has the command line that Hydra reads, and Hydra raises errors instead
        of printing them.
        """
        import hydra

        replaced = Replaced(self.command, [] if self._is_only_shown else self._arguments)
        command_line, debug = sys.argv, os.environ.get(_DEBUG)
        # A log file that cannot be written is no reason for a traceback among the messages.
        logging.raiseExceptions = debug == "1"
        sys.argv = [f"tactorch {self.command}", *self._arguments]
        os.environ[_DEBUG] = "1"
        try:
            path, name = f"pkg://{SEARCH_PACKAGE}", store_config(self._schema, self._unnamed)
            register_names()
            hydra.main(version_base="1.3", config_path=path, config_name=name)(self.job)()
            summarize(self._jobs)
        except KeyboardInterrupt:
            replaced.restore(interrupted=True)
            message = f"tactorch {self.command}: interrupted"
            if self._place is not None and has_state(self.command, self._place):
                run = Path(os.path.relpath(self._place))
                message += f"; continue with tactorch {self.command} resume={run}"
            elif self.command in CONTINUING:
                message += "; the same command continues"
            print(message, file=sys.stderr)
            sys.exit(console.INTERRUPTED)
        except Exception as error:
            replaced.restore()
            if debug == "1" or self._started:
                raise
            fail(_composition_error(error), self.command)
        finally:
            sys.argv = command_line
            os.environ.pop(_DEBUG)
            if debug is not None:
                os.environ[_DEBUG] = debug
        if self._failures:
            replaced.restore()
            sys.exit(console.WRONG)

    def job(self, cfg: "DictConfig") -> Any:
        """Run the command once; errors raised on purpose become a message."""
        from hydra.core.hydra_config import HydraConfig

        self._started = True
        self._place = Path(HydraConfig.get().runtime.output_dir)
        failures = self._failures
        result = self._run(cfg)
        if self._swept:
            words = [word.partition("=") for word in HydraConfig.get().overrides.task]
            differing = {key: value for key, _, value in words if key in self._swept}
            self._jobs.append(Job(self._place, differing, self._failures > failures))
        return result

    def _run(self, cfg: "DictConfig") -> Any:
        from tactorch.versions import versions

        note = ", ".join(f"{name} {version}" for name, version in versions().items())
        try:
            console.to_log_file(f"tactorch {self.command} with {note}")
            options = build_options(self.command, cfg)
            self._check_output(getattr(options, "out", None), options.overwrite)
            # Where a progress bar shows the iterations, their lines go to the log file only.
            has_bar = console.is_rich(sys.stderr) and console.is_rich()
            lines = console.terminal_log(console.is_no_iteration) if has_bar else nullcontext()
            at_terminal = console.is_rich(sys.stderr)  # which shows parts of the command
            STARTED.set()  # not before: the options of some commands take long imports
            whole = nullcontext() if at_terminal else progress_line(self.command)
            with _plain_warnings(), lines, whole:
                return command_module(self.command).run(options)
        except TactorchError as error:
            self._report(str(error))
        except OSError as error:
            self._report(f"{error}; check that path, its permissions and the free space.")
        except MemoryError as error:
            self._report(
                f"out of memory ({error}); use a coarser mesh, fewer presses or optimizer=lbfgs."
            )
        finally:
            STARTED.set()
        return None

    def _report(self, message: str) -> None:
        """Print an error; other jobs of a sweep still run."""
        self._failures += 1
        _print_error(message, self.command)
        with suppress(FileError):  # of a log that cannot be written
            console.to_log_file(f"error: {message}", error=True)

    def _check_output(self, out: Path | None, overwrite: bool) -> None:
        """Refuse an output that exists, or that other jobs of a sweep write."""
        if out is None:
            return
        path = Path(out).resolve()
        if path in self._outputs:
            raise ConfigError(
                f"out={out} is written by more than one job; put what differs in its name, as in "
                "out='x-${seed}.h5', or leave it out: each job has its own folder."
            )
        self._outputs.add(path)
        if self.command not in WRITING_FOLDERS:
            check_file(Path(out), overwrite)


class _Flags(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ConfigError(
            f"{' '.join(message.split())}; settings are KEY=VALUE, without dashes: see {self.prog} "
            "--help."
        )


def _read_flags(command: str, words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return the flags that a command takes, and its settings."""
    parser = _Flags(f"tactorch {command}", add_help=False, allow_abbrev=False)
    parser.add_argument("--multirun", "-m", action="store_true")
    parser.add_argument("--cfg", "-c", choices=("job", "hydra", "all"))
    parser.add_argument("--package", "-p")
    parser.add_argument("--config-dir", "-cd")
    parser.add_argument("--trust", action="append", default=[])
    parser.add_argument("--info", "-i", nargs="?", const="all")
    for flag in ("--resolve", "--trust-config-dir", "--hydra-help"):
        parser.add_argument(flag, action="store_true")
    flags, settings = parser.parse_known_args(words)
    if any(word.startswith("-") for word in settings):
        parser.error(f"unrecognized arguments: {' '.join(settings)}")
    if flags.resolve and not flags.cfg:
        parser.error("--resolve needs --cfg")
    return flags, settings


def _composition_error(error: Exception) -> str:
    """Return the message of an error that came before the command started."""
    from hydra.errors import HydraException

    if isinstance(error, OSError):
        return f"the run folder cannot be made or written ({error}); choose another run_dir."
    cause = f" ({error.__cause__})" if error.__cause__ else ""
    kind = "" if isinstance(error, HydraException) else f"{type(error).__name__}: "
    return f"{kind}{error}{cause}"


def fail(message: str, command: str = "") -> NoReturn:
    """Print one message and end the process."""
    _print_error(message, command)
    sys.exit(console.WRONG)


def _print_error(message: str, command: str) -> None:
    """Print an error as one line, also where a library's message has several."""
    start = f"tactorch {command}".rstrip()
    print(f"{start}: error: {printable(' '.join(message.split()))}", file=sys.stderr)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings of tactorch as their message alone, on the terminal and in the log."""
    usual: Callable[..., None] = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **file: Any) -> None:
        if category is UserWarning:
            logging.getLogger("tactorch").warning("warning: %s", message)
        else:
            usual(message, category, *place, **file)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
