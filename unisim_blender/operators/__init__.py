"""What users can do, one file a subject. Operators gather, call and report; the work is in `bridge` and in core."""

from . import (
    actors,
    assets,
    background,
    check,
    ego,
    export_scenario,
    import_drive,
    looks,
    paths,
    points,
    render_sequence,
    retime,
    sensors,
    static_items,
    test_renderer,
    train,
)

MODULES = (
    import_drive,
    export_scenario,
    actors,
    looks,
    paths,
    retime,
    static_items,
    ego,
    sensors,
    points,
    background,
    render_sequence,
    train,
    test_renderer,
    check,
    assets,
)
