"""The service over HTTP: JSON described by OpenAPI, live data, metrics, pages."""

from twin.api.app import make_app
from twin.api.serving import serve, served

__all__ = ["make_app", "serve", "served"]
