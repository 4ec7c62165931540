"""CONFIG.toml: what is read, and what is said of mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from foundation.errors import InputError, UnknownNameError
from hil.settings import parse_toml
from twin.settings import Settings, settings_of

HEAD = """
[[twin]]
name = "arm"
rate = 100
[twin.plant]
model = "Twinproof.Plants.Pendulum"
"""


def _read(text: str) -> Settings:
    return settings_of(parse_toml(text, Path("service.toml")))


def test_defaults_and_units() -> None:
    settings = _read(HEAD + '[twin.estimator]\nmemory = "1 min"\nblock = "50 ms"\n')
    twin = settings.twin("arm")
    assert (twin.rate, twin.estimator.memory, twin.estimator.block) == (100.0, 60.0, 0.05)
    assert settings.service.address == ("127.0.0.1", 8460)
    assert settings.service.is_loopback
    assert len(twin.buses) == 1


def test_several_buses() -> None:
    text = HEAD + '[[twin.bus]]\nchannel = "a"\n[[twin.bus]]\nchannel = "b"\n'
    assert [bus.channel for bus in _read(text).twins[0].buses] == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no twin"),
        (HEAD + HEAD, "two twins are called 'arm'"),
        (HEAD.replace('"arm"', '"../x"'), "no name of a twin"),
        (HEAD + "[twin.drift]\nfalse_alarms_per_hour = 0\n", "false_alarms_per_hour = 0"),
        (HEAD + '[twin.estimator]\nblock = "15 ms"\n', "multiple of the sample time"),
        ('[service]\nlisten = "here"\n' + HEAD, "no address"),
        (HEAD + '[twin.drift]\nwindow = "2 V"\n', "cannot be converted"),
    ],
)
def test_mistakes_are_named(text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        _read(text)
    assert said in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    "text",
    [
        HEAD + '[twin.estimator]\nfree = ["jj"]\n',
        HEAD + "[twin.estimator.disturbances]\nvolt = 1.0\n",
        HEAD + "[twin.drifts]\n",
    ],
)
def test_names_that_nothing_has(text: str) -> None:
    with pytest.raises(UnknownNameError, match=r"service\.toml"):
        _read(text)
