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
        f"{found['sensor']}: the model misses a value of the reference frame by {before:.2%} of "
        f"the frame's rms, calibrated by {after:.2%}; {found['factor']:.4g} board units per V/A.\n"
    )
    if not found["credible"]:
        head += (
            "Calibration explains less than half of it, so that frames are not corrected: what is "
            "left is noise, or the sensor differs in other ways than electrodes and gains.\n"
        )
        return Group(Text(head))
    columns = Table("electrode", "shift mm", "contact x", "channel", "gain %", box=None)
    for column in columns.columns:
        column.justify = "right"
    electrodes, channels = found["electrodes"], found["channels"]
    for k in range(max(len(electrodes), len(channels))):
        columns.add_row(
            *(_electrode(electrodes[k]) if k < len(electrodes) else ("", "", "")),
            *(_channel(channels[k]) if k < len(channels) else ()),
        )
    note = (
        "\n± and */: one standard deviation. In a suite, `calibrated = true` in a scenario gives "
        "methods frames that are corrected by this."
    )
    return Group(Text(head), columns, Text(note))


def _electrode(of: dict[str, Any]) -> tuple[str, str, str]:
    return (
        str(of["electrode"]),
        f"{of['shift_mm']:+.2f} ± {of['shift_mm_sd']:.2f}",
        f"{of['contact_impedance']:.2f} */ {of['contact_impedance_sd_factor']:.2f}",
    )


def _channel(of: dict[str, Any]) -> tuple[str, str]:
    a, b = of["channel"]
    return f"{a}-{b}", f"{100 * (of['gain'] - 1):+.2f} ± {100 * of['gain_sd']:.2f}"
