"""A progress line for a terminal or a notebook, without dependencies."""

import sys
import time
from typing import Any, TextIO


class Progress:
    """A callback for :func:`trimip.train` and :func:`trimip.capture` that shows the progress in one line.

    >>> trimip.train({"data.root": "data/lego"}, callback=trimip.Progress())
    """

    def __init__(self, file: TextIO | None = None, interval: float = 0.2) -> None:
        """Writes to ``file`` (default: standard error), at most every ``interval`` seconds."""
        self.file, self.interval = file, interval
        self._last, self._width = 0.0, 0

    def _write(self, text: str, end: str = "") -> None:
        file = self.file or sys.stderr
        # Spaces overwrite the rest of a longer previous line.
        file.write("\r" + text.ljust(self._width) + end)
        file.flush()
        self._width = 0 if end else len(text)

    def __call__(self, event: dict[str, Any]) -> None:
        """Shows an event."""
        kind = event.get("kind")
        if kind == "step":
            now = time.monotonic()
            if now - self._last < self.interval:
                return
            self._last = now
            part = f"{100 * event['progress']:3.0f} %"
            self._write(f"{part}  step {event['totals']['step']}  {event['batch_psnr']:.2f} dB  {event['seconds_left']:.0f} s left")
        elif kind == "evaluation":
            name = "at the end" if event["last"] else f"after {event['totals']['seconds']:.0f} s"
            self._write(f"{name}: {event['psnr']:.2f} dB, SSIM {event['ssim']:.4f}", "\n")
        elif kind == "warning":
            self._write(f"warning: {event['message']}", "\n")
        elif kind == "note":
            self._write(event["text"], "\n")
        elif kind == "progress":
            now = time.monotonic()
            if now - self._last >= self.interval:
                self._last = now
                self._write(f"{event['doing']}, {event['done']} of {event['total']}")
        elif kind == "done":
            self._write(f"{event['stage']}: done, {event['seconds']:.0f} s", "\n")
