"""The ``farfield`` command: one file a verb. Only the chosen verb's module is imported."""

import errno
import io
import os
import sys
import traceback
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import update_wrapper
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any

from farfield.cli._help import HELP, HELP_ALL, help_text
from farfield.cli._output import note_command
from farfield.errors import FarfieldError, MissingExtraError

GROUPS = {
    "begin": {
        "demo": "simulate, detect, score and report: no data, no GPU",
        "new-dataset": "write an example of an own data set, to put your own files in its place",
        "formats": "list the formats that are read and written: how certain, how to open",
        "detectors": "list the detectors with their size, speed and score",
        "experiments": "list the experiments that ship, or print one as YAML",
        "bench": "measure this machine's rates, and plan what a whole data set takes",
    },
    "look at data": {
        "doctor": "say what a data set holds, what is missing and how to fix it",
        "stats": "count a data set: frames by condition, boxes by class, range, visibility",
        "compare": "set the statistics of two data sets side by side: figures and a table",
        "show": "draw one frame from above: a cloud, or the radar's power",
        "radar": "look at 4D radar frames: power, Doppler, echoes, beside the camera",
        "view": "look at a data set in the browser, with detections beside the truth",
    },
    "make and prepare data": {
        "simulate": "write a simulated data set in a real data set's layout",
        "convert": "write a data set in another layout, or as a fast binary cache",
        "annotate": "draw and fix boxes and tracks in the browser",
        "anonymize": "cover faces in pictures, originals untouched; resumes by itself",
        "sync": "match streams of stamps to one of them: offsets, drift, gaps",
        "calibrate": "solve where radar, camera or a second LiDAR stands, with residuals",
        "odometry": "find the poses of drives from their sweeps, and how far they drift",
        "depth": "write dense depth maps of the cameras from the LiDAR, with uncertainty",
    },
    "train": {
        "train": "train a detector: a shipped experiment or one YAML file; resumes by itself",
        "adapt": "adapt a detector to your own unlabelled sweeps; resumes by itself",
        "reproduce": "put a paper's tables to the test: a grid of trainings, decisions, one page",
        "import-weights": "turn a checkpoint of OpenPCDet or K-Radar's kit into a weights file",
        "export": "write a trained detector as an ONNX file that runs without torch",
    },
    "detect and score": {
        "predict": "detect objects in clouds or a data set and write the boxes",
        "evaluate": "run a detector over a data set and score it by range",
        "score": "score the files of any detector, without a model",
        "track": "give detections identities and velocities over time",
        "worst": "list the frames and objects on which an evaluation lost most, with pictures",
        "compare-results": "set results side by side, never two conventions in one column",
        "report": "turn an evaluation into one self-contained HTML page",
    },
}
"""The verbs and what each does, by what they are for."""
VERBS = {verb: what for group in GROUPS.values() for verb, what in group.items()}


RESUMING = frozenset(
    {"demo", "simulate", "convert", "train", "adapt", "reproduce", "predict", "evaluate", "odometry", "anonymize"}
    | {"depth", "report"}
)
"""Verbs that go on where they were stopped: they keep what is done in a journal or a checkpoint."""

_VERBOSE = ("-v", "--verbose")


def overview() -> str:
    """Return the text of ``farfield --help``."""
    verbs = "\n".join(
        "\n".join([f"{title}:", *(f"  {verb:<16}{what}" for verb, what in group.items())])
        for title, group in GROUPS.items()
    )
    return (
        "farfield: 3D object detection at long range and in all weather\n\n"
        "examples:\n"
        "  farfield demo\n"
        "  farfield doctor Cirrus_dataset1\n"
        "  farfield simulate cirrus-sim data/sim --frames 100\n"
        "  farfield train pointpillars-cirrus-sim -o training.steps=500\n"
        "  farfield score predictions.csv labels.csv --protocol dds --json scores.json\n\n"
        f"{verbs}\n\n"
        "everywhere:\n"
        "  VERB --help         what a verb does, in a screen; --help-all: every flag\n"
        "  -v, --verbose       show where an error came from\n"
        "  --version           print the version\n"
        "  --completion SHELL  complete verbs, flags and names: source <(farfield --completion bash)\n"
    )


def main(arguments: list[str] | None = None) -> int:
    """Run one verb and return the exit status: 0 done, 1 findings or failure, 2 wrong usage, 130 after Ctrl-C.

    141 where nobody reads what it prints any more, as behind ``| head``.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if sys.stdout is None:  # closed by the shell: `>&-`
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - until the process ends
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - until the process ends
    for stream in (sys.stdout, sys.stderr):  # names of files need not be UTF-8, nor the terminal
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    verb = next((word for word in arguments if word in VERBS), "")
    try:
        try:
            return _status(arguments)
        finally:  # help too, after which tyro leaves by SystemExit
            sys.stdout.flush()
    except BrokenPipeError:
        _forget_output()
        return 141
    except OSError as error:
        message = _refused(error)
        _forget_output()
    _complain(f"{f'farfield {verb}'.strip()}: {message}")
    return 1


def _status(arguments: list[str]) -> int:
    """Exit status of what the words ask for; refusals of the operating system are the caller's to say."""
    if len(arguments) == 2 and arguments[0] == "help":
        arguments = [arguments[1], "--help"]
    if not arguments or arguments[0] in ("-h", "--help", "--help-all", "help"):
        print(overview(), end="")
        return 0 if arguments else 2
    if arguments[0] in ("-V", "--version"):
        from farfield import __version__

        print(f"farfield {__version__}")
        return 0
    if arguments[0] == "--completion":
        return _print_completion(arguments[1:])
    verbose = any(word in _VERBOSE for word in arguments)
    arguments = [word for word in arguments if word not in _VERBOSE]
    note_command(arguments)
    if not arguments:
        print(overview(), end="")
        return 2
    verb, rest = arguments[0], arguments[1:]
    if verb not in VERBS:
        from farfield.cli._words import no_verb

        _complain(no_verb(arguments, VERBS))
        return 2
    from farfield.files.outputs import of_command
    from farfield.jobs.process import ended_by_signals, without_torch_folder

    try:
        with ended_by_signals(), without_torch_folder(), of_command(verb):
            return _run(import_module(f"farfield.cli.{verb.replace('-', '_')}").run, verb, rest)
    except FarfieldError as error:
        if verbose:
            traceback.print_exc()
        message = str(error)
    except ImportError as error:
        missing = MissingExtraError.of(error, f"farfield {verb}")
        if missing is None:
            raise
        message = str(missing)
    except KeyboardInterrupt:
        _complain(f"farfield {verb}: interrupted. {_again(verb)}")
        return 130
    except SystemExit as ended:
        if ended.code == _TERMINATED:
            _complain(f"farfield {verb}: ended by SIGTERM. {_again(verb)}")
        raise
    _complain(f"farfield {verb}: {message}")
    return 1


def _complain(text: str) -> None:
    """Print on the error stream, if it takes it."""
    with suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


_TERMINATED = 128 + 15


def _again(verb: str) -> str:
    """How a verb that was stopped is gone on with."""
    return f"Run the same command again{': it resumes where it stopped' if verb in RESUMING else ''}."


def _forget_output() -> None:
    """Let nothing more be written where nobody reads or no room is left; the interpreter would at its end."""
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        return
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _refused(error: OSError) -> str:
    """What the operating system refused, in a sentence, and what may help."""
    path = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else None
    path = path.parent if path is not None and path.name.endswith(".part") else path  # of an atomic write
    if error.errno == errno.EISDIR:
        return f"{path}: expected a file, found a folder."
    what = error.strerror or str(error) or type(error).__name__
    helps = _HELPS.get(error.errno or 0, "")
    return f"{what if path is None else f'{path}: {what}'}.{helps}"


_HELPS = {
    errno.ENOSPC: " Make room, then run the same command again: what is done is kept.",
    errno.EDQUOT: " Make room, then run the same command again: what is done is kept.",
    errno.EACCES: " Give yourself the right to it, or name another place.",
    errno.EPERM: " Give yourself the right to it, or name another place.",
    errno.EROFS: " Name a place that can be written.",
    errno.ENAMETOOLONG: " Choose shorter names.",
    errno.EMFILE: " Take fewer --workers, or raise the limit: ulimit -n 4096.",
}


def _print_completion(words: list[str]) -> int:
    from farfield.cli._completion import SHELLS, script

    if len(words) != 1 or words[0] not in SHELLS:
        _complain(f"farfield --completion: expected one of {', '.join(SHELLS)}, got {' '.join(words)!r}")
        return 2
    print(script(words[0], VERBS), end="")
    return 0


def _run(function: Callable[..., int | None], verb: str, arguments: list[str]) -> int:
    if {HELP_ALL, *HELP} & set(arguments):
        from farfield.cli._completion import arguments_of

        print(help_text(verb, function, arguments_of(verb), everything=HELP_ALL in arguments), end="")
        return 0
    import tyro

    call: Any = update_wrapper(lambda *args, **kwargs: (args, kwargs), function)  # parses, and does nothing yet
    with io.StringIO() as printed:
        try:
            with redirect_stderr(printed), redirect_stdout(printed):
                args, kwargs = tyro.cli(call, prog=f"farfield {verb}", args=arguments)
        except SystemExit as ended:
            if ended.code == _TERMINATED:  # by a signal, while it parsed
                raise
            _complain(f"farfield {verb}: {_refusal(verb, printed.getvalue())}")
            return 2
    from farfield.cli._remote import run_with_urls

    return int(run_with_urls(function, args, kwargs, signature(function).parameters) or 0)


def _refusal(verb: str, printed: str) -> str:
    """The sentence on words that the parser refused."""
    from farfield.cli._completion import arguments_of, flags_of
    from farfield.cli._words import refused_words

    required = [argument for argument in arguments_of(verb) if argument.required and not argument.option_strings]
    return refused_words(verb, printed, flags_of(verb), required)
