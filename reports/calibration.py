"""What a calibration found, for people."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Group


def table(found: dict[str, Any]) -> "Group":
    """Electrodes and channels side by side, under what the calibration explains."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    before, after = found["misfit_before"], found["misfit_after"]
    head = (
        f"{found['sensor']}: the model misses an untouched value by {before:.2%} of the frame's "
        f"rms, calibrated by {after:.2%}; {found['factor']:.4g} board units per V/A.\n"
    )
    if not found["credible"]:
        head += (
            "This explains less than half of it, so frames are not corrected: what is left is "
            "noise, or the sensor differs in other ways.\n"
        )
    columns = Table("electrode", "shift mm", "contact x", "channel", "gain %", box=None)
    for column in columns.columns:
        column.justify = "right"
    electrodes, channels = found["electrodes"], found["channels"]
    for k in range(max(len(electrodes), len(channels))):
        cells = [""] * 5
        if k < len(electrodes):
            of = electrodes[k]
            cells[:3] = [
                str(of["electrode"]),
                f"{of['shift_mm']:+.2f}",
                f"{of['contact_impedance']:.2f}",
            ]
        if k < len(channels):
            cells[3:] = [str(channels[k]["channel"]), f"{100 * (channels[k]['gain'] - 1):+.2f}"]
        columns.add_row(*cells)
    return Group(Text(head), columns)
