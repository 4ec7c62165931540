"""Logs as JSON, one line an entry, on standard error: for journald or whatever collects them."""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime

# What every record has; anything else was given as `extra`.
_PLAIN = {*vars(logging.makeLogRecord({})), "message", "asctime", "color_message"}


class JsonFormatter(logging.Formatter):
    """Formats a record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        document: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        document |= {k: v for k, v in vars(record).items() if k not in _PLAIN}
        if record.exc_info:
            document["exception"] = self.formatException(record.exc_info)
        return json.dumps(document, ensure_ascii=False, default=str)


def set_up(level: int = logging.INFO) -> None:
    """Send all logs of this process to standard error as JSON."""
    handler = logging.StreamHandler()
    handler.setFormatter(JsonFormatter())
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level)
    # One line a request, or a step of a library's, would drown the rest.
    for name in ("uvicorn.access", "alembic", "pint"):
        logging.getLogger(name).setLevel(logging.ERROR if name == "pint" else logging.WARNING)
