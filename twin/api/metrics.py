"""What Prometheus asks for. `twin/pages/static/grafana.json` shows it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

from twin.service import Service

_P = "twinproof_"


class _Metrics(Collector):
    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterator[Metric]:
        service = self._service
        yield _gauge("up", "1 while the twins are being fed", float(service.is_alive))
        yield _gauge("started_seconds", "When the service began", service.started)
        yield _gauge(
            "store_failing", "1 while the store fails", float(bool(service.journal.failure))
        )
        yield _gauge("journal_waiting", "Events that wait for the store", service.journal.waiting)
        yield _counter("journal_lost", "Events there was no room for", service.journal.lost)
        yield _gauge("live_readers", "Who read live data now", service.hub.readers)
        yield _counter("live_missed", "Texts that readers were too slow for", service.hub.missed)
        yield from _of_twins(service)


def _of_twins(service: Service) -> Iterator[Metric]:
    gauges = {
        "verified": "1 while nothing puts the last verification in doubt",
        "gate_open": "1 while the deployed controller may be deployed",
        "verifying": "1 while a verification is under way",
        "telemetry_age_seconds": "Age of the newest good frame",
        "verified_age_seconds": "Age of the verification that covers the plant",
        "excitation": "How well recent data tell parameters: 1 suffices",
        "faults": "What fails around the twin",
    }
    plain = {n: GaugeMetricFamily(_P + n, text, labels=["twin"]) for n, text in gauges.items()}
    parameter = {
        n: GaugeMetricFamily(_P + n, text, labels=["twin", "parameter"])
        for n, text in {
            "parameter": "As estimated, in its unit",
            "parameter_sd": "Standard deviation of the estimate",
            "parameter_verified": "As verified",
            "parameter_verified_sd": "Standard deviation of what was verified",
        }.items()
    }
    drift = {
        n: GaugeMetricFamily(_P + n, text, labels=["twin", "test"])
        for n, text in {
            "drift_statistic": "Of a test for drift",
            "drift_threshold": "From the stated rate of false alarms",
        }.items()
    }
    counts = CounterMetricFamily(
        _P + "frames", "Frames and samples by what became of them", labels=["twin", "what"]
    )
    for name in service.monitors:
        view = service.numbers(name)
        for key, value in _plain(view).items():
            _add(plain[key], [name], value)
        for key, p in view["parameters"].items():
            verified = p["verified"] or {}
            values = (p["value"], p["sd"], verified.get("value"), verified.get("sd"))
            for family, value in zip(parameter.values(), values, strict=True):
                _add(family, [name, key], value)
        for key, test in view["drift"].items():
            _add(drift["drift_statistic"], [name, key], test["statistic"])
            _add(drift["drift_threshold"], [name, key], test["threshold"])
        for key, value in view["counts"].items():
            counts.add_metric([name, key], value)
    yield from (*plain.values(), *parameter.values(), *drift.values(), counts)


def _plain(view: dict[str, Any]) -> dict[str, float | None]:
    verified_at = view["gate"]["verified_at"]
    return {
        "verified": float(view["state"] == "verified"),
        "gate_open": float(view["gate"]["allowed"]),
        "verifying": float(view["verifying"]),
        "telemetry_age_seconds": view["age"],
        "verified_age_seconds": None if verified_at is None else view["time"] - verified_at,
        "excitation": view["excitation"],
        "faults": float(len(view["faults"])),
    }


def _add(family: GaugeMetricFamily, labels: list[str], value: float | None) -> None:
    if value is not None:
        family.add_metric(labels, value)


def _gauge(name: str, text: str, value: float) -> GaugeMetricFamily:
    return GaugeMetricFamily(_P + name, text, value)


def _counter(name: str, text: str, value: float) -> CounterMetricFamily:
    return CounterMetricFamily(_P + name, text, value)


def exposition(service: Service) -> tuple[str, str]:
    """Return all metrics and their media type."""
    registry = CollectorRegistry()
    registry.register(_Metrics(service))
    return generate_latest(registry).decode(), CONTENT_TYPE_LATEST
