"""Progress bars, which are drawn on a terminal only, so that logs stay free of them."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any, TextIO


class Bars:
    """A :data:`~mixer_torch.scoring.Progress` callback that draws one bar for each stage of work.

    A bar appears after 0.3 seconds, so that short stages show none, and is removed when its stage
    ends.

    Args:
        stream: The stream to draw on, if it is a terminal; standard error if None.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self.stream = sys.stderr if stream is None else stream
        self.visible = self.stream.isatty()
        self._stage: str | None = None
        self._bar: Any = None

    def __enter__(self) -> Bars:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def __call__(self, what: str, done: int, of: int) -> None:
        if not self.visible:
            return
        if what != self._stage:
            from tqdm import tqdm

            self.close()
            self._stage = what
            self._bar = tqdm(total=of, desc=what, file=self.stream, leave=False, delay=0.3)
        self._bar.total = of
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        """Remove the bar of the current stage."""
        if self._bar is not None:
            self._bar.close()
        self._bar = self._stage = None
