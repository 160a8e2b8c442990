"""Passwords, tokens and keys, from a file or an environment variable, never the configuration; and certificates."""

from __future__ import annotations

import os
import ssl
import stat
from pathlib import Path
from typing import Any

from residua.errors import SettingError
from residua.live.setting_checks import file

#: Bytes of a file that holds a secret, at most.
LARGEST = 65_536


def secret(settings: Any, name: str) -> str | None:
    """Return a secret named by settings; ``None`` if they name none.

    Parameters
    ----------
    settings : object
        With texts ``<name>_file`` and ``<name>_env``, of which at most one is not empty.
    name : str
        Such as ``"password"``.

    Returns
    -------
    str or None
        The text of the file without the line end after it, or the value of the environment variable.

    Raises
    ------
    SettingError
        If both are there; the file cannot be read, may be read by every user of the machine (POSIX), or is too large;
        the variable is not set; or the secret is empty, has more lines than one or is not text. The message never has
        the secret in it.

    Examples
    --------
    >>> import os
    >>> from types import SimpleNamespace
    >>> os.environ["PLANT_PASSWORD"] = "a secret"
    >>> secret(SimpleNamespace(password_file="", password_env="PLANT_PASSWORD"), "password")
    'a secret'
    >>> secret(SimpleNamespace(password_file="", password_env=""), "password") is None
    True
    """
    path, variable = getattr(settings, f"{name}_file"), getattr(settings, f"{name}_env")
    check_secret(settings, name)
    if path:
        return _checked(_of_file(path, f"{name}_file"), f"{name}_file: {path}")
    if variable:
        value = os.environ.get(variable)
        if value is None:
            # An invalid name may be the secret itself.
            shown = f" {variable}" if variable.isidentifier() else " with an invalid name"
            raise SettingError(f"{name}_env: the environment variable{shown} is not set")
        return _checked(value, f"{name}_env: the environment variable {variable}")
    return None


def check_secret(settings: Any, name: str) -> None:
    """Raise if settings name a secret twice; neither place is read.

    Raises
    ------
    SettingError
    """
    if getattr(settings, f"{name}_file") and getattr(settings, f"{name}_env"):
        raise SettingError(f"{name}_file and {name}_env: only one of them, the file or the environment variable")


def _of_file(path: str, key: str) -> str:
    try:
        with Path(path).open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            if os.name == "posix" and mode & stat.S_IROTH:
                raise SettingError(
                    f"{key}: every user of this machine may read {path} (its mode is {stat.S_IMODE(mode):03o}): "
                    f"take that away first, chmod 600 {path}"
                )
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise SettingError(f"{key}: {path} cannot be read: {error.strerror or error}") from error
    if len(content) > LARGEST:
        raise SettingError(f"{key}: {path} has more than {LARGEST} bytes, too many for a secret")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        raise SettingError(f"{key}: {path} is not text in UTF-8") from None  # the cause repeats its content
    return text.removesuffix("\n").removesuffix("\r")


def _checked(value: str, where: str) -> str:
    if not value:
        raise SettingError(f"{where} is empty; it must contain a secret")
    if not value.isprintable():
        raise SettingError(f"{where} holds line ends or control characters; a secret is one line of text")
    return value


def check_tls(settings: Any) -> None:
    """Raise if settings name certificates without TLS, files that do not exist, or a certificate without its key.

    Raises
    ------
    SettingError
    """
    for key in ("ca_file", "cert_file", "key_file"):
        if getattr(settings, key, ""):
            if not settings.tls:
                raise SettingError(f"{key}: it is for TLS: set tls = true")
            file(settings, key)
    if bool(getattr(settings, "cert_file", "")) != bool(getattr(settings, "key_file", "")):
        raise SettingError("cert_file: a certificate and its key go together: cert_file and key_file")


def tls_context(settings: Any) -> ssl.SSLContext:
    """Return a context that checks the name and certificates of a server, and shows a certificate if there is one.

    Raises
    ------
    SettingError
        If the certificates cannot be read.
    """
    try:
        context = ssl.create_default_context(cafile=settings.ca_file or None)
        if getattr(settings, "cert_file", ""):
            context.load_cert_chain(settings.cert_file, settings.key_file)
    except (OSError, ssl.SSLError) as error:
        raise SettingError(f"ca_file, cert_file: the certificates cannot be read: {error}") from error
    return context
