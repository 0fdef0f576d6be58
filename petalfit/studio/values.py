"""What a browser may set the controls to: it is checked here, whatever the page itself allows."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import viser
from viser import _messages


def check_values(client: viser.ClientHandle, refuse: Callable[[str], None]) -> None:
    """Refuses values that a control cannot have, before viser converts and stores them.

    Args:
        client: The browser.
        refuse: A function that is called with an error message for the user.
    """
    gui = client.gui
    update = gui._handle_gui_updates

    async def checked(sender: Any, message: _messages.GuiUpdateMessage) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid)
        if handle is None:
            return
        # Other members, such as what is called when a value changes, are none of the browser's business.
        if set(message.updates) != {"value"} or not may_be(handle, message.updates["value"]):
            refuse("A control was set to something that it cannot be; nothing has changed.")
        elif handle.visible and not handle.disabled:
            await update(sender, message)

    gui._websock_interface.unregister_handler(_messages.GuiUpdateMessage, update)
    gui._websock_interface.register_handler(_messages.GuiUpdateMessage, checked)


def may_be(handle: Any, value: Any) -> bool:
    """Whether a control can have a value."""
    match handle:
        case viser.GuiButtonHandle() | viser.GuiCheckboxHandle():
            return isinstance(value, bool)
        case viser.GuiDropdownHandle() | viser.GuiButtonGroupHandle():
            return isinstance(value, str) and value in handle.options
        case viser.GuiSliderHandle() | viser.GuiNumberHandle():
            return _between(value, handle.min, handle.max)
        case viser.GuiVector2Handle():
            return _are(value, 2, lambda x: _between(x, None, None))
        case viser.GuiRgbHandle():
            return _are(value, 3, lambda x: type(x) is int and 0 <= x <= 255)
    return False


def _are(values: Any, count: int, holds: Callable[[Any], bool]) -> bool:
    return isinstance(values, list | tuple) and len(values) == count and all(map(holds, values))


def _between(value: Any, low: float | None, high: float | None) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return False
    return (low is None or low <= value) and (high is None or value <= high)
