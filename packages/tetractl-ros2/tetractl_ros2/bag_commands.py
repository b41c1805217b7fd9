"""`tetractl rosbag-tables` and `tetractl export-rosbag`: convert from and to ROS 2 recordings."""

from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import Log, argument, option, out_option
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.tools.files import write_atomically


def rosbag_tables(
    bag: Annotated[
        Path, argument("BAG", "A rosbag2 recording: its folder, or one .mcap or .db3 file.")
    ],
    out: Annotated[Path, out_option("DIR", "Folder to write poses.csv and commands.csv to.")],
    topic: Annotated[
        str | None,
        option("NAME", "Use poses from this topic only. [all topics, one for each robot]"),
    ] = None,
    frame: Annotated[
        str | None,
        option(
            "NAME", "Use poses in this coordinate frame only. [the only frame in the recording]"
        ),
    ] = None,
) -> int:
    """Write the poses and commands of a rosbag2 recording as CSV tables for `identify`.

    Poses come from TFMessage, PoseStamped, PoseWithCovarianceStamped, Odometry and NamedPoseArray,
    commands from Twist and TwistStamped. Without commands, only poses.csv is written.

    Example: tetractl rosbag-tables recording -o tables && tetractl identify tables/*.csv
    """
    from tetractl.tools.table.table_files import format_csv
    from tetractl_ros2.bag_tables import command_table, pose_table, read_bag

    contents = read_bag(bag)
    if not contents.poses:
        raise UsageError(
            f"{printable(str(bag))}: the recording has no poses in a message type that can be read"
        )
    tables = {"poses.csv": pose_table(contents, topic, frame)}
    if contents.commands:
        tables["commands.csv"] = command_table(contents)
    out.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        write_atomically(out / name, format_csv(table).encode())
        print(printable(str(out / name)))
    return Exit.DONE


def export_rosbag(
    log: Log, out: Annotated[Path, out_option("DIR", "Folder to create for the recording.")]
) -> int:
    """Write a trial as a rosbag2 recording (MCAP): poses, commands, plans and targets.

    Example: tetractl export-rosbag logs/batch/trial-000.mcap -o trial && ros2 bag play trial
    """
    from tetractl.log.read.reader import read_trial
    from tetractl_ros2.bag_of_log import write_bag

    trial = read_trial(log)
    ui.warn_of_damage(str(log), trial.damage)
    count = write_bag(trial, out)
    print(f"{printable(str(out))}: {count} messages")
    return Exit.DONE if trial.damage is None else Exit.FAILED
