"""Secrets come out of files and environment variables, and never stand in what is said of them."""

from __future__ import annotations

import os
from types import SimpleNamespace

import pytest

from residua.errors import SettingError
from residua.live.secrets import LARGEST, secret

WORD = "tr0ub4dor&3 ünd mehr"


def settings(**given):
    return SimpleNamespace(**({"password_file": "", "password_env": ""} | given))


@pytest.fixture
def kept(tmp_path):
    """Return a file with content that only its owner may read."""

    def write(content: bytes, mode: int = 0o600) -> str:
        path = tmp_path / "password"
        path.write_bytes(content)
        path.chmod(mode)
        return str(path)

    return write


def test_nothing_is_asked_for_where_nothing_is_set():
    assert secret(settings(), "password") is None


@pytest.mark.parametrize(("end", "mode"), [("", 0o600), ("\n", 0o600), ("\r\n", 0o600), ("", 0o400), ("", 0o640)])
def test_a_file_of_the_owner_or_a_group_is_read_without_its_line_end(kept, end, mode):
    assert secret(settings(password_file=kept((WORD + end).encode(), mode)), "password") == WORD


def test_a_variable(monkeypatch):
    monkeypatch.setenv("A_PASSWORD", WORD)
    assert secret(settings(password_env="A_PASSWORD"), "password") == WORD


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize("mode", [0o644, 0o604, 0o666])
def test_a_file_that_everybody_may_read_is_refused(kept, mode):
    with pytest.raises(SettingError, match=rf"password_file: every user.*mode is {mode:03o}.*chmod 600"):
        secret(settings(password_file=kept(WORD.encode(), mode)), "password")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"\n", "is empty"),
        (f"{WORD}\n{WORD}\n".encode(), "line ends"),
        (WORD.encode() + b"\x00", "control characters"),
        (b"\xff\xfe" + WORD.encode(), "UTF-8"),
        (b"x" * (LARGEST + 1), "more than"),
    ],
)
def test_what_is_no_secret_is_refused_without_being_shown(kept, content, said):
    with pytest.raises(SettingError, match=said) as caught:
        secret(settings(password_file=kept(content)), "password")
    assert caught.value.__cause__ is None
    assert "tr0ub" not in str(caught.value)


def test_what_is_not_there(tmp_path, monkeypatch):
    monkeypatch.delenv("NO_PASSWORD", raising=False)
    with pytest.raises(SettingError, match=r"password_file.*cannot be read: No such file"):
        secret(settings(password_file=str(tmp_path / "none")), "password")
    with pytest.raises(SettingError, match="password_env: the environment variable NO_PASSWORD is not set"):
        secret(settings(password_env="NO_PASSWORD"), "password")


def test_only_one_place(kept):
    with pytest.raises(SettingError, match="only one of them"):
        secret(settings(password_file=kept(WORD.encode()), password_env="A_PASSWORD"), "password")
