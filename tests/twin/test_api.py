"""The API: what it answers, to whom, and that nothing asked of it is a fault of its own."""

import asyncio
import json
import re
import threading
import time

import httpx2
import pytest
import schemathesis
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from prometheus_client.parser import text_string_to_metric_families
from schemathesis.checks import not_a_server_error, response_schema_conformance
from scripted import read_config, scripted_service, settle, write_config

from foundation.errors import InputError, StoreError, UnknownNameError
from twin.api import make_app, served
from twin.api.app import PAGES
from twin.api.serving import tokens_of
from twin.hub import Hub
from twin.tokens import Tokens, add_token, read_tokens
from twin.verification import controller_hash

HASH = "0" * 64


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with scripted_service(tmp_path_factory.mktemp("api"), ("robot", "crane")) as found:
        settle(found)
        yield found


@pytest.fixture(scope="module")
def secrets(tmp_path_factory):
    path = tmp_path_factory.mktemp("tokens") / "tokens.toml"
    made = {
        name: add_token(path, name, scopes)
        for name, scopes in {
            "eyes": ["read"],
            "hands": ["read", "operate"],
            "maria": ["read", "operate", "approve"],
        }.items()
    }
    return path, made


@pytest.fixture
def client(service):
    return TestClient(make_app(service, Tokens()))


@pytest.fixture
def guarded(service, secrets):
    return TestClient(make_app(service, read_tokens(secrets[0])))


def bearer(secret):
    return {"Authorization": f"Bearer {secret}"}


def deployed(service):
    return controller_hash(service.settings.path.parent / "pid.toml")


def test_the_gate_answers_for_a_controller_by_its_hash(client, service):
    found = client.get("/gate", params={"twin": "robot", "controller": deployed(service)}).json()
    assert found["allowed"]
    assert found["evidence"]
    other = client.get("/gate", params={"twin": "robot", "controller": HASH}).json()
    assert not other["allowed"]
    assert "another controller" in other["because"]
    assert client.get("/gate", params={"twin": "nobody", "controller": HASH}).status_code == 404
    assert client.get("/gate", params={"twin": "robot", "controller": "x"}).status_code == 422
    evidence = client.get(f"/evidence/{found['evidence']}").json()
    assert evidence["evidence"]["passed"]
    lineage = client.get(f"/lineage/approval:{found['evidence']}").json()["artifacts"]
    assert lineage[0]["kind"] == "approval"


def test_a_twin_is_seen_in_brief_and_in_full(client):
    names = [t["name"] for t in client.get("/twins").json()["twins"]]
    assert names == ["robot", "crane"]
    found = client.get("/twins/robot").json()
    assert found["parameters"]["J"]["value"] == 0.5
    assert found["parameters"]["J"]["unit"] == "kg.m2"
    assert found["parameters"]["J"]["verified"] == {"value": 0.5, "sd": pytest.approx(0.02)}
    assert found["parameters"]["d"]["verified"]["sd"] == 0.0
    assert found["drift"]["J"] == {"statistic": 1.5, "threshold": 5.0}
    channel = found["channels"]["theta"]
    assert len(channel["time"]) == len(channel["residual"]) == 201
    assert channel["residual"][5] == pytest.approx(0.1)
    assert client.get("/twins/nobody").status_code == 404


def test_events_come_newest_first_and_in_pages(client):
    first = client.get("/events", params={"limit": 3}).json()["events"]
    numbers = [e["number"] for e in first]
    assert numbers == sorted(numbers, reverse=True)
    assert len(numbers) == 3
    rest = client.get("/events", params={"before": numbers[-1]}).json()["events"]
    assert [e["number"] for e in rest] == list(range(numbers[-1] - 1, 0, -1))
    promoted = client.get("/events", params={"kind": "promoted", "twin": "crane"}).json()["events"]
    assert [(e["twin"], e["kind"]) for e in promoted] == [("crane", "promoted")]
    assert client.get("/audit").json() == {"events": numbers[0], "intact": True, "because": ""}


def test_without_tokens_one_can_only_read_and_only_here(client):
    for path in ("verify", "rollback", "approve"):
        answer = client.post(f"/twins/robot/{path}", json={"parameters": HASH})
        assert answer.status_code == 403
        assert "none are set up" in answer.json()["detail"]
    # A page from elsewhere that has given this machine a name of its own.
    assert client.get("/twins", headers={"Host": "evil.example:8460"}).status_code == 403
    for host in ("localhost", "127.0.0.1:8460", "[::1]:8460"):
        assert client.get("/twins", headers={"Host": host}).status_code == 200


READ = [
    *("/twins", "/twins/robot", "/events", "/audit", "/metrics", "/live", "/twins/robot/live"),
    *(f"/evidence/{HASH}", f"/lineage/{HASH}", "/twins/robot/parameters"),
    *("/twins/robot/history?name=J", f"/gate?twin=robot&controller={HASH}"),
]


def test_with_tokens_every_scope_is_needed_where_it_is_said(guarded, service, secrets):
    eyes, hands = (bearer(secrets[1][n]) for n in ("eyes", "hands"))
    for path in READ:
        assert guarded.get(path).status_code == 401
        assert guarded.get(path, headers=bearer("guess")).status_code == 401
    for path in READ[:5]:
        assert guarded.get(path, headers=eyes).status_code == 200
    assert guarded.post("/twins/robot/verify", headers=eyes).status_code == 403
    assert guarded.post("/reload", headers=eyes).status_code == 403
    assert guarded.post("/reload", headers=hands).json()["changed"] == []
    for path in ("approve", "rollback"):
        body = {"parameters": HASH}
        answer = guarded.post(f"/twins/robot/{path}", headers=hands, json=body)
        assert answer.status_code == 403
        assert "approve" in answer.json()["detail"]
    # Whether it lives may be asked by anybody; it says nothing else.
    assert guarded.get("/healthz").json() == {"ok": True, "faults": {}}
    assert guarded.get("/readyz").status_code == 200


def test_every_route_of_the_description_is_behind_a_scope_or_meant_to_be_open(guarded):
    schema = guarded.get("/openapi.json").json()
    open_ = {p for p, item in schema["paths"].items() for o in item.values() if "security" not in o}
    assert open_ == {"/healthz", "/readyz"}
    assert len(schema["paths"]) == 18


def test_approval_and_roll_back_carry_the_token_s_name(tmp_path, secrets):
    options = {"verification": None}
    with scripted_service(tmp_path, **options) as service:
        settle(service)
        client = TestClient(make_app(service, read_tokens(secrets[0])))
        maria = bearer(secrets[1]["maria"])
        first = client.get("/twins/robot/parameters", headers=maria).json()["sets"][0]["id"]
        body = {"parameters": first}
        assert client.post("/twins/robot/rollback", headers=maria).status_code == 409
        assert client.post("/twins/robot/approve", headers=maria, json=body).status_code == 200
        unknown = client.post("/twins/robot/approve", headers=maria, json={"parameters": HASH})
        assert unknown.status_code == 409
        told = client.get("/events", params={"kind": "approval"}, headers=maria).json()["events"]
        assert told[0]["detail"]["token"] == "maria"
        assert client.post("/twins/robot/verify", headers=maria).status_code == 202
        assert service.monitor("robot").next_job()[1] == "asked by maria"


def test_a_store_that_fails_is_503_not_500(client, service, monkeypatch):
    def fail(*_, **__):
        raise StoreError("the database fails: gone")

    monkeypatch.setattr(service.store, "events", fail)
    answer = client.get("/events")
    assert answer.status_code == 503
    assert "gone" in answer.json()["detail"]
    monkeypatch.setattr(service.journal, "_failure", "gone")
    assert client.get("/readyz").status_code == 503
    assert client.get("/healthz").status_code == 200


def test_metrics_are_what_prometheus_reads_and_the_dashboard_shows(client, service):
    text = client.get("/metrics").text
    families = {f.name: f for f in text_string_to_metric_families(text)}
    assert families["twinproof_gate_open"].samples[0].value == 1.0
    values = {s.labels["parameter"]: s.value for s in families["twinproof_parameter"].samples}
    assert values == {"J": 0.5, "mgl": 2.0, "d": 0.1}
    names = {s.name for f in families.values() for s in f.samples}
    dashboard = json.loads((PAGES / "static" / "grafana.json").read_text())
    shown = {
        name
        for panel in dashboard["panels"]
        for target in panel.get("targets", [])
        for name in re.findall(r"twinproof_\w+", target["expr"])
    }
    assert len(dashboard["panels"]) >= 6
    assert shown
    assert shown <= names
    ids = [panel["id"] for panel in dashboard["panels"]]
    assert len(ids) == len(set(ids))


def test_pages_are_whole_and_from_here(client):
    for path in ("/", "/pages/twin", "/pages/events"):
        page = client.get(path)
        assert page.status_code == 200
        assert "default-src 'self'" in page.headers["content-security-policy"]
        for link in re.findall(r'(?:src|href)="([^"]+)"', page.text):
            assert link.startswith("/")
            assert client.get(link).status_code == 200
        # What stands in the page itself, the policy would not let run.
        assert not re.search(r"<script(?![^>]*src=)|<style| on\w+=| style=", page.text)
    for file in (PAGES / "static").iterdir():
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", file.read_text())


@pytest.mark.parametrize(
    ("listen", "tokens", "refused"),
    [
        ("127.0.0.1:1", "", False),
        ("[::1]:1", "", False),
        ("0.0.0.0:1", "", True),
        ("192.0.2.1:1", "", True),
        ("0.0.0.0:1", "empty.toml", True),
        ("0.0.0.0:1", "tokens.toml", False),
    ],
)
def test_it_does_not_listen_elsewhere_without_tokens(tmp_path, listen, tokens, refused):
    write_config(tmp_path)
    (tmp_path / "empty.toml").write_text("")
    add_token(tmp_path / "tokens.toml", "maria", ["read"])
    path = tmp_path / "config.toml"
    text = path.read_text().replace('listen = "127.0.0.1:0"', f'listen = "{listen}"')
    path.write_text(text.replace("[service]", f'[service]\ntokens = "{tokens}"'))
    if refused:
        with pytest.raises(InputError, match="without tokens"):
            tokens_of(read_config(path))
    else:
        assert bool(tokens_of(read_config(path))) == bool(tokens)


def test_tokens_are_kept_as_hashes_for_their_owner_only(tmp_path):
    path = tmp_path / "tokens.toml"
    secret = add_token(path, "maria", ["read", "approve"])
    assert secret not in path.read_text()
    assert path.stat().st_mode & 0o077 == 0
    assert read_tokens(path).find(secret).scopes == ("read", "approve")
    with pytest.raises(InputError, match="already"):
        add_token(path, "maria", ["read"])
    with pytest.raises(UnknownNameError):
        add_token(path, "jo", ["everything"])
    with pytest.raises(InputError, match="no name"):
        add_token(path, 'x"\n[[token]]', ["read"])
    assert len(read_tokens(path).tokens) == 1


# Live data: a real server, since a test client waits for the end of a stream.


def test_many_readers_get_live_data_and_an_end(tmp_path):
    async def read(client, url, count):
        found = []
        async with client.stream("GET", url) as answer:
            async for line in answer.aiter_lines():
                if line.startswith("data: "):
                    found.append(json.loads(line[6:]))
                if len(found) == count:
                    return found
        return found

    async def everybody(base):
        limits = httpx2.Limits(max_connections=None)
        async with httpx2.AsyncClient(timeout=30, limits=limits) as client:
            readers = [read(client, f"{base}/twins/robot/live", 3) for _ in range(20)]
            readers.append(read(client, f"{base}/live", 2))
            return await asyncio.gather(*readers)

    with scripted_service(tmp_path) as service:
        settle(service)
        with served(make_app(service, Tokens())) as server:
            stop = threading.Event()

            def rounds():
                while not stop.wait(0.05):
                    service.clock.now += 0.05
                    service._next.clear()
                    service.step()

            thread = threading.Thread(target=rounds)
            thread.start()
            found = asyncio.run(everybody(server.url))
            stop.set()
            thread.join()
            end = time.monotonic() + 10
            while service.hub.readers and time.monotonic() < end:
                time.sleep(0.01)
            assert service.hub.readers == 0
    assert [len(f) for f in found] == [3] * 20 + [2]
    for documents in found[:-1]:
        times = [d["time"] for d in documents]
        assert times == sorted(set(times))
    assert found[-1][0]["twins"][0]["name"] == "robot"


def test_a_slow_reader_misses_and_others_do_not_wait():
    async def scenario():
        hub = Hub()
        slow, fast = hub.stream("a"), hub.stream("a")
        hub.publish("a", "first")
        assert await anext(slow) == await anext(fast) == b"data: first\n\n"
        for k in range(100):
            hub.publish("a", str(k))
            await asyncio.sleep(0)
            assert await anext(fast) == f"data: {k}\n\n".encode()
        hub.publish("b", "nothing to do with it")
        # The newest is there; what came before is gone.
        assert await anext(slow) == b"data: 99\n\n"
        hub.close()
        await fast.aclose()
        await slow.aclose()
        assert hub.missed == 99
        assert hub.readers == 0

    asyncio.run(scenario())


# Whatever is asked: no 5xx, and answers as the description says.


def _fuzzed(service, path):
    schema = schemathesis.openapi.from_asgi("/openapi.json", make_app(service, read_tokens(path)))
    # Streams do not end; they have tests of their own.
    return schema.exclude(path_regex="/live$")


@pytest.mark.parametrize("who", ["nobody", "eyes", "maria"])
def test_nothing_that_is_asked_is_a_fault_of_ours(tmp_path, secrets, who):
    service = scripted_service(tmp_path, ("robot", "crane"))
    settle(service)
    headers = bearer(secrets[1].get(who, "guess"))
    schema = _fuzzed(service, secrets[0])
    operations = [o.ok() for o in schema.get_all_operations()]
    assert len(operations) == 16

    for operation in operations:

        @settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
        @given(operation.as_strategy())
        def one(case):
            case.headers = {**(case.headers or {}), **headers}
            answer = case.call()
            case.validate_response(
                answer,
                checks=[not_a_server_error, response_schema_conformance],
            )

        one()
    assert service.store.audit().intact
    service.close()
