"""From exceptions to exit codes: a user sees a message, never a traceback."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any

import typer
from typer.core import TyperGroup

from torchreg.cli.signals import Terminated, terminable
from torchreg.cli.wording import by_options
from torchreg.report.text import legible

UNEXPECTED, BAD_INPUT, NOT_REGISTERED, INTERRUPTED = 1, 2, 3, 130
"""Exit codes besides 0; typer itself uses 2 for bad usage."""

_DEBUG = "TORCHREG_DEBUG"


class GuardedGroup(TyperGroup):
    """A group of commands that end with a message and an exit code whatever happens inside them.

    ``ValueError`` (of which ``CloudFileError`` is one) and ``OSError`` are mistakes of the user: 2. Any other exception
    is a defect: 1. A signal that ends the process gives 128 and its number. With ``TORCHREG_DEBUG=1`` in the
    environment, exceptions pass through. Warnings are said in the words of the command line, too.
    """

    def invoke(self, ctx: Any) -> Any:  # noqa: ANN401  # the context's type is another one in older typers
        """Run the command that was asked for."""
        with terminable(), warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: complain(str(message))
            return self._guarded(ctx)

    def _guarded(self, ctx: Any) -> Any:  # noqa: ANN401
        if os.environ.get(_DEBUG) == "1":
            return super().invoke(ctx)
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            _silence_stdout()
            raise typer.Exit(UNEXPECTED) from None
        except Terminated as error:
            complain(str(error))
            raise typer.Exit(error.code) from None
        except KeyboardInterrupt:
            complain("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        except (ValueError, OSError) as error:
            complain(str(error) or type(error).__name__)
            raise typer.Exit(BAD_INPUT) from None
        except Exception as error:
            if hasattr(error, "exit_code") or isinstance(error, typer.Abort):
                raise  # typer's own, such as bad usage
            complain(f"unexpected {type(error).__name__}: {error} ({_DEBUG}=1 shows where)")
            raise typer.Exit(UNEXPECTED) from None


def complain(message: str) -> None:
    """Print a message on standard error, in the words of the command line."""
    typer.echo(f"torchreg: {legible(by_options(message))}", err=True)


def _silence_stdout() -> None:
    """The reader of the output is gone: let the interpreter flush the rest into nothing."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
