"""The names of presets and of mixtures, as type checkers and editors see them."""

from __future__ import annotations

from typing import Literal

PresetName = Literal[
    "paper",
    "paper_code",
    "screen_photo",
    "phone_at_monitor",
    "phone_at_laptop",
    "phone_at_phone",
    "phone_at_television",
    "phone_at_led_wall",
    "webcam_at_phone",
    "document_camera_at_tablet",
    "dashcam_at_led_sign",
    "phone_close_to_lcd",
    "phone_at_whole_screen",
    "phone_at_tablet_by_window",
    "phone_at_dimmed_phone",
    "phone_across_room_at_television",
]
MixtureName = Literal["anywhere"]
