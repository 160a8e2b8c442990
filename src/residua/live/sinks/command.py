"""Events to a program, on its standard input."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from residua.errors import SettingError
from residua.live.delivery import DeliveryError, OneByOne, RefusedError
from residua.live.events import Event
from residua.live.setting_checks import check_types, seconds

#: The exit status of a program that can make nothing of its input (EX_DATAERR of sysexits.h).
REFUSED = 65


@dataclass(frozen=True)
class Settings:
    """Settings of the program.

    Attributes
    ----------
    command : tuple of str
        The program and its arguments, as they are: no shell reads them.
    timeout : float
        Seconds that the program may take for an event; then it is ended.
    drop_refused : bool
        Whether an event that the program refuses with status 65 is given up; otherwise it is tried again, for ever, and
        those after it wait.
    name : str
        Of the sink; empty: ``"command "`` and the file name of the program.

    Raises
    ------
    SettingError
        If there is no program or no time for it.
    """

    command: tuple[str, ...]
    timeout: float = 30.0
    drop_refused: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        check_types(self)
        seconds(self, "timeout")
        if not self.command or not self.command[0]:
            raise SettingError("command: the program and its arguments are expected, each one text; no shell reads it")


class Command(OneByOne):
    """Sink that runs a program for each event, one line of JSON on its standard input; status 0 means delivered.

    The output of the program goes to the standard error of the run. The program and its children are ended when their
    time is over (on Windows only the program itself).

    Parameters
    ----------
    settings : Settings

    Raises
    ------
    SettingError
        If there is no such program.
    """

    kind: ClassVar[str] = "command"

    def __init__(self, settings: Settings) -> None:
        if shutil.which(settings.command[0]) is None:
            raise SettingError(f"command: there is no program {settings.command[0]!r}, or it must not be run")
        self._settings, self.drop_refused = settings, settings.drop_refused
        self._program = Path(settings.command[0]).name
        self.name = settings.name or f"command {self._program}"

    def send(self, event: Event) -> None:
        """Run the program for an event.

        Raises
        ------
        DeliveryError
            If it did not take the event: another status, no end in time, or it cannot be started.
        """
        status = self._run(event)
        if status == REFUSED:
            raise RefusedError(
                f"{self._program} refuses the event (status {REFUSED}); drop_refused = true goes on without it"
            )
        if status:
            ended = f"was ended by signal {-status}" if status < 0 else f"ended with status {status}"
            raise DeliveryError(f"{self._program} {ended}")

    def _run(self, event: Event) -> int:
        posix = sys.platform != "win32"
        try:
            process = subprocess.Popen(
                self._settings.command,
                stdin=subprocess.PIPE,
                stdout=2,  # the standard output is the run's own
                start_new_session=posix,
            )
        except OSError as error:
            raise DeliveryError(f"{self._program} cannot be started: {error.strerror or error}") from error
        with process:
            try:
                process.communicate(event.to_json().encode() + b"\n", timeout=self._settings.timeout)
            except subprocess.TimeoutExpired:
                raise DeliveryError(
                    f"{self._program} took more than {self._settings.timeout:g} s and was ended"
                ) from None
            finally:
                if process.returncode is None:
                    os.killpg(process.pid, signal.SIGKILL) if posix else process.kill()
        return process.wait()
