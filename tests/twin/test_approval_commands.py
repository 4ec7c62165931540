"""`twin approve` and `twin rollback`: what a person says, under a token's name."""

import json

import pytest
from click.testing import CliRunner
from scripted import scripted_service, wait_for_verification

from foundation.errors import InputError
from twin.api import make_app, served
from twin.tokens import Tokens, add_token, read_tokens
from twinproof.cli import command

TOKEN = 'approval = "token"'


@pytest.fixture
def site(tmp_path):
    """A twin whose first parameters have passed and wait, and tokens of two people."""
    file = tmp_path / "tokens.toml"
    secrets = {
        "maria": add_token(file, "maria", ["read", "approve"]),
        "eyes": add_token(file, "eyes", ["read"]),
    }
    with scripted_service(tmp_path, settings=TOKEN) as service:
        wait_for_verification(service)
        with served(make_app(service, read_tokens(file))) as server:
            yield service, server.url, secrets


def say(site, *words, who="maria"):
    _, url, secrets = site
    env = {"TWINPROOF_TOKEN": secrets.get(who, "")}
    line = ["twin", *words, "--url", url, "--json", "-"]
    return CliRunner().invoke(command, line, standalone_mode=False, env=env)


def verified_anew(service):
    """Verify other parameters a while later; return the twin's monitor."""
    monitor = service.monitor("robot")
    for _ in range(2):
        service.clock.now += 6.0
        monitor.pipeline.at(service.clock.now - 0.01, J=0.51)
        monitor.feed([])
    monitor.ask_for_verification("test")
    wait_for_verification(service)
    return monitor


def test_what_waits_is_approved_and_rolled_back(site):
    service = site[0]
    assert not service.monitor("robot").life.is_verified
    done = json.loads(say(site, "approve", "--twin", "robot").stdout)
    assert done["schema"] == "twinproof/twin-approve/1"
    kinds = {e["kind"]: e["detail"] for e in done["events"]}
    assert kinds["approval"]["token"] == "maria"
    assert service.monitor("robot").life.is_verified
    first = kinds["promoted"]["parameters"]

    nothing = say(site, "approve", "--twin", "robot")
    assert "no parameters wait for approval" in str(nothing.exception)
    none_before = say(site, "rollback", "--twin", "robot")
    assert "no earlier parameters were in force" in str(none_before.exception)

    # Another set, a while later: then the first can be had back.
    monitor = verified_anew(service)
    prefix = monitor.journal.store.parameter_sets("robot", 1)[0]["id"][:10]
    unknown = say(site, "approve", "--twin", "robot", "--parameters", "f00")
    assert prefix in str(unknown.exception)
    assert say(site, "approve", "--twin", "robot", "--parameters", prefix).return_value == 0
    assert monitor.reference.values["J"] == 0.51
    back = json.loads(say(site, "rollback", "--twin", "robot").stdout)
    assert back["schema"] == "twinproof/twin-rollback/1"
    assert back["gate"]["allowed"] is False
    assert back["events"][0]["detail"] == {"parameters": first, "token": "maria"}
    assert monitor.reference.values["J"] == 0.5


def test_an_id_that_several_sets_have_is_not_approved(site):
    service = site[0]
    monitor = verified_anew(service)
    refused = say(site, "approve", "--twin", "robot", "--parameters", "")
    assert "begins the ids of 2 sets that wait" in str(refused.exception)
    assert not monitor.life.is_verified


@pytest.mark.parametrize("words", [("approve",), ("rollback",)])
def test_who_may_not_is_told_how_to(site, words):
    wrong = say(site, *words, "--twin", "robot", who="eyes")
    assert isinstance(wrong.exception, InputError)
    assert "the token 'eyes' has no scope 'approve'" in str(wrong.exception)
    assert "twinproof twin token NAME --scope" in str(wrong.exception)
    nobody = say(site, *words, "--twin", "robot", who="nobody")
    assert "--token-file" in str(nobody.exception)
    unknown = say(site, *words, "--twin", "robt")
    assert "did you mean robot" in str(unknown.exception)
    assert not site[0].monitor("robot").life.is_verified


def test_without_tokens_nobody_approves(tmp_path):
    with scripted_service(tmp_path, settings=TOKEN) as service:
        wait_for_verification(service)
        with served(make_app(service, Tokens())) as server:
            refused = say((service, server.url, {}), "approve", "--twin", "robot")
    assert "none are set up" in str(refused.exception)
    assert "service.tokens" in str(refused.exception)
