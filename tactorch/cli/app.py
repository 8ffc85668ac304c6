"""One command as a Hydra app, whose every error is one message on standard error."""

import argparse
import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

from tactorch.cli.logs import to_log_file
from tactorch.cli.status import INTERRUPTED, WRONG
from tactorch.cli.tables import is_rich
from tactorch.text import printable

if TYPE_CHECKING:
    from omegaconf import DictConfig

_DEBUG = "HYDRA_FULL_ERROR"


def run_app(command: str, words: Sequence[str]) -> None:
    """Run the Hydra app of a command; ends the process with a status other than 0 on errors."""
    from tactorch.cli.help import help_text, wants_help
    from tactorch.errors import TactorchError

    if wants_help(words):
        print(help_text(command, words))
        return
    # A log file that cannot be written is no reason for a traceback among the messages.
    logging.raiseExceptions = os.environ.get(_DEBUG) == "1"
    try:
        app = _prepare(command, words)
    except TactorchError as error:
        fail(str(error), command)
    try:
        app.run()
    except KeyboardInterrupt:
        print(f"tactorch {command}: interrupted{app.continuation()}", file=sys.stderr)
        sys.exit(INTERRUPTED)
    if app.failed:
        sys.exit(WRONG)


def _prepare(command: str, words: Sequence[str]) -> "App":
    """Check flags and settings before Hydra composes them.

    Raises:
        ConfigError: a flag or a setting cannot be used.
        FileError: the folder of settings, or of the run to resume, cannot be read.
    """
    from tactorch.cli.foreign import add_folder
    from tactorch.cli.overrides import check_overrides, check_required, key_of
    from tactorch.cli.resume import with_resume
    from tactorch.cli.schema import load_schema
    from tactorch.errors import ConfigError

    flags, settings = _read_flags(command, words)
    schema = load_schema(command)
    if flags.config_dir and flags.trust_config_dir:  # whatever its files hold, Hydra composes it
        if any(key_of(word) == "resume" for word in settings):
            raise ConfigError("resume takes plain settings; leave out --trust-config-dir.")
        return App(schema, flags, settings)
    if flags.config_dir:
        add_folder(schema, Path(flags.config_dir))
    settings = check_overrides(schema, settings, multirun=flags.multirun)
    settings = with_resume(schema, settings, multirun=flags.multirun)
    if not (flags.cfg or flags.hydra_help or flags.info is not None):
        check_required(schema, settings)
    return App(schema, flags, settings)


class _Flags(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        from tactorch.errors import ConfigError

        raise ConfigError(
            f"{' '.join(message.split())}; settings are KEY=VALUE, without dashes: see {self.prog} "
            "--help."
        )


def _read_flags(command: str, words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return Hydra's flags that a command takes, and its settings."""
    parser = _Flags(f"tactorch {command}", add_help=False, allow_abbrev=False)
    parser.add_argument("--multirun", "-m", action="store_true")
    parser.add_argument("--cfg", "-c", choices=("job", "hydra", "all"))
    parser.add_argument("--resolve", action="store_true")
    parser.add_argument("--package", "-p")
    parser.add_argument("--config-dir", "-cd")
    parser.add_argument("--trust-config-dir", action="store_true")
    parser.add_argument("--hydra-help", action="store_true")
    parser.add_argument("--info", "-i", nargs="?", const="all")
    flags, settings = parser.parse_known_args(words)
    if any(word.startswith("-") for word in settings):
        parser.error(f"unrecognized arguments: {' '.join(settings)}")
    if flags.resolve and not flags.cfg:
        parser.error("--resolve needs --cfg")
    return flags, settings


class App:
    """A command with its settings; Hydra calls `job`, once or, in a sweep, for each combination."""

    def __init__(self, schema: Any, flags: argparse.Namespace, settings: Sequence[str]) -> None:
        self.command, self.failed = schema.command, False
        self._schema, self._flags, self._settings = schema, flags, settings
        self._started = False
        self._place: Path | None = None
        self._outputs: set[Path] = set()

    def run(self) -> None:
        """Let Hydra compose the settings and call `job`."""
        import hydra

        from tactorch.cli.compose import SEARCH_PACKAGE, store_config

        debugging = os.environ.get(_DEBUG) == "1"
        with _hydra_process(f"tactorch {self.command}", self._arguments()):
            name = store_config(self._schema)
            path = f"pkg://{SEARCH_PACKAGE}"
            app = hydra.main(version_base="1.3", config_path=path, config_name=name)
            try:
                app(self.job)()
            except Exception as error:
                if debugging or self._started:
                    raise
                fail(_composition_error(error), self.command)

    def _arguments(self) -> list[str]:
        """Return the command line that Hydra reads."""
        flags = self._flags
        chosen = {
            "--multirun": flags.multirun,
            "--resolve": flags.resolve,
            "--hydra-help": flags.hydra_help,
        }
        valued = {"--cfg": flags.cfg, "--package": flags.package, "--info": flags.info}
        if flags.trust_config_dir:
            valued["--config-dir"] = flags.config_dir
        words = [flag for flag, given in chosen.items() if given]
        words += [word for flag, value in valued.items() if value for word in (flag, value)]
        return [*self._settings, *words]

    def job(self, cfg: "DictConfig") -> Any:
        """Run the command once; errors raised on purpose become a message."""
        from hydra.core.hydra_config import HydraConfig

        from tactorch.cli.compose import build_options
        from tactorch.cli.schema import command_module
        from tactorch.errors import TactorchError
        from tactorch.versions import versions

        self._started = True
        self._place = Path(HydraConfig.get().runtime.output_dir)
        note = ", ".join(f"{name} {version}" for name, version in versions().items())
        to_log_file(f"tactorch {self.command} with {note}")
        try:
            options = build_options(self.command, cfg)
            self._check_output(getattr(options, "out", None))
            with _plain_warnings(), _no_lines_in_the_bar():
                return command_module(self.command).run(options)
        except TactorchError as error:
            self._report(str(error))
        except OSError as error:
            self._report(f"{error}; check that path, its permissions and the free space.")
        except MemoryError as error:
            self._report(
                f"out of memory ({error}); use a coarser mesh, fewer presses or optimizer=lbfgs."
            )
        return None

    def continuation(self) -> str:
        """Return the end of a sentence, where a run that was stopped can be continued."""
        from tactorch.cli.resume import has_state

        if self._place is None or not has_state(self.command, self._place):
            return ""
        place = Path(os.path.relpath(self._place))
        return f"; continue with tactorch {self.command} resume={place}"

    def _report(self, message: str) -> None:
        """Print an error; other jobs of a sweep still run."""
        self.failed = True
        _print_error(message, self.command)
        to_log_file(f"error: {message}", error=True)

    def _check_output(self, out: Path | None) -> None:
        """Refuse that jobs of a sweep write the same file."""
        from tactorch.errors import ConfigError

        if out is None:
            return
        path = Path(out).resolve()
        if path in self._outputs:
            raise ConfigError(
                f"out={out} is written by more than one job; put what differs in its name, as in "
                "out='x-${seed}.h5', or leave it out: each job has its own folder."
            )
        self._outputs.add(path)


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
    sys.exit(WRONG)


def _print_error(message: str, command: str) -> None:
    """Print an error as one line, also where a library's message has several."""
    start = f"tactorch {command}".rstrip()
    print(f"{start}: error: {printable(' '.join(message.split()))}", file=sys.stderr)


@contextmanager
def _hydra_process(program: str, arguments: Sequence[str]) -> Iterator[None]:
    """Set the command line that Hydra reads, and let it raise errors instead of printing them."""
    given, debug = sys.argv, os.environ.get(_DEBUG)
    sys.argv, os.environ[_DEBUG] = [program, *arguments], "1"
    try:
        yield
    finally:
        sys.argv = given
        os.environ.pop(_DEBUG)
        if debug is not None:
            os.environ[_DEBUG] = debug


@contextmanager
def _no_lines_in_the_bar() -> Iterator[None]:
    """Where a progress bar shows the iterations, keep their lines to the log file."""
    handlers = [h for h in logging.getLogger().handlers if not isinstance(h, logging.FileHandler)]
    if not (is_rich(sys.stderr) and is_rich()):
        handlers = []
    for handler in handlers:
        handler.addFilter(_is_not_iteration)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(_is_not_iteration)


def _is_not_iteration(record: logging.LogRecord) -> bool:
    return record.name != "tactorch.inverse.monitor" or record.levelno > logging.INFO


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings of tactorch as their message alone, on the terminal and in the log."""
    usual: Callable[..., None] = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if category is UserWarning:
            logging.getLogger("tactorch").warning("warning: %s", message)
        else:
            usual(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield
