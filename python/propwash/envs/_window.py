"""A window that shows pictures of environments: ``render_mode="human"``."""

from __future__ import annotations

import os
from typing import Any, Sequence

import numpy as np
from numpy.typing import NDArray

from .. import _native
from .._optional import need

#: Worlds that are shown at most, side by side.
MOST = 4

_NO_DISPLAY = (
    'render_mode="human" opens a window, and there is no display (DISPLAY or WAYLAND_DISPLAY): run it in a desktop session, or take '
    'render_mode="rgb_array", whose render() gives the pictures'
)


class Window:
    """One window, opened with the first pictures. Once its user has closed it, nothing is shown any more."""

    def __init__(self, hz: int, n_worlds: int) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        self._pygame: Any = need("pygame", "window", 'render_mode="human"')
        if not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")):
            raise _native.Error(_NO_DISPLAY)
        self._hz = hz
        self._title = "Propwash" if n_worlds <= MOST else f"Propwash: the first {MOST} of {n_worlds} worlds"
        self._screen: Any = None
        self._clock: Any = None
        self.closed = False

    def show(self, pictures: Sequence[NDArray[np.uint8]]) -> None:
        """Shows pictures, (height, width, 3) each, in two columns where there are several, and waits until the last have been there for a
        step of the environment."""
        if self.closed:
            return
        pygame = self._pygame
        height, width = pictures[0].shape[:2]
        columns = 1 if len(pictures) == 1 else 2
        rows = -(-len(pictures) // columns)
        if self._screen is None:
            try:
                pygame.display.init()
                self._screen = pygame.display.set_mode((columns * width, rows * height))
            except pygame.error as e:
                raise _native.Error(f"{_NO_DISPLAY} ({e})") from e
            pygame.display.set_caption(self._title)
            self._clock = pygame.time.Clock()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        for k, picture in enumerate(pictures):
            surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
            self._screen.blit(surface, (k % columns * width, k // columns * height))
        pygame.display.flip()
        self._clock.tick(self._hz)

    def close(self) -> None:
        """Closes it for good."""
        if self._screen is not None:
            self._pygame.display.quit()
            self._screen = None
        self.closed = True
