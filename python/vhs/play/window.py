"""A window that shows pictures and takes keys.

tkinter, because it comes with Python: nothing to install on most machines, and pictures and keys are all that
is needed.
"""

from __future__ import annotations

import tkinter
from collections.abc import Callable

from PIL import Image

from vhs.errors import OutputError
from vhs.show.pictures import HEIGHT_PX, WIDTH_PX


class Window:
    """One picture, its keys and a clock."""

    def __init__(self, title: str) -> None:
        """Open it.

        Raises:
            OutputError: there is no display.
        """
        try:
            self._root = tkinter.Tk()
        except tkinter.TclError as error:
            raise OutputError(f"{error}; a film needs no display: --out FILE.gif") from error
        self._root.title(title)
        self._root.resizable(False, False)
        self._canvas = tkinter.Canvas(self._root, width=WIDTH_PX, height=HEIGHT_PX, highlightthickness=0)
        self._canvas.pack()
        self._item = self._canvas.create_image(0, 0, anchor="nw")
        self._root.bind("<Escape>", lambda _: self.close())

    def show(self, picture: Image.Image) -> None:
        """Show a picture in place of the last one."""
        header = b"P6 %d %d 255 " % picture.size
        # The canvas keeps no reference of its own: without this one the picture vanishes.
        self._shown = tkinter.PhotoImage(data=header + picture.tobytes(), format="PPM")
        self._canvas.itemconfigure(self._item, image=self._shown)

    def on_key(self, key: str, then: Callable[[], None]) -> None:
        """Call `then` when a key is pressed; `key` is its name in Tk, such as "Up" or "space"."""
        self._root.bind(f"<KeyPress-{key}>", lambda _: then())

    def after(self, seconds: float, then: Callable[[], None]) -> None:
        """Call `then` later."""
        self._root.after(round(1000 * seconds), then)

    def press(self, key: str) -> None:
        """Press a key, as a person would."""
        self._root.update()
        self._root.focus_force()
        self._root.event_generate(f"<KeyPress-{key}>")

    def close(self) -> None:
        """Close it; `run` then returns."""
        self._root.destroy()

    def run(self) -> None:
        """Serve the window until it is closed; an error in a callback ends it and is raised here."""
        failed: list[BaseException] = []

        def fail(kind: object, error: BaseException, trace: object) -> None:
            failed.append(error)
            self.close()

        self._root.report_callback_exception = fail
        self._root.mainloop()
        if failed:
            raise failed[0]
