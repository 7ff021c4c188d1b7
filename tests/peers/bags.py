"""Files of other writers: a push of 1.2 mm on a spring of 250 N/m, as bags of ROS 2 and files of MATLAB.

Forces at 20 Hz, joint states at 20 Hz half a period later, three places of the tip; the same as a session's columns in MATLAB.

Usage: bags.py FOLDER
"""

import pathlib
import sys

import numpy
import scipy.io
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as RosWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START_NS = 1_764_000_000_123_456_789
PERIOD_NS = 50_000_000
ROWS = 60
SPRING_N_PER_M = 250.0
HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
VECTOR = """
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
POSE = """
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


def pushed_m(time_ns):
    """Displacement at a time."""
    return 1.2e-3 * min(max(1e-9 * (time_ns - START_NS) - 1.0, 0.0), 1.0)


def forces():
    """Times and forces along y."""
    times = [START_NS + PERIOD_NS * row for row in range(ROWS)]
    return [(time, SPRING_N_PER_M * pushed_m(time)) for time in times]


def positions():
    """Times and positions of the joint."""
    times = [START_NS + PERIOD_NS // 2 + PERIOD_NS * row for row in range(ROWS)]
    return [(time, pushed_m(time)) for time in times]


def tips():
    """Times and deflections of the tip, 30 mm from the first guide."""
    times = [START_NS + PERIOD_NS * row for row in (20, 40, 55)]
    return [(time, 0.5 * pushed_m(time)) for time in times]


def split(time_ns):
    """Seconds and nanoseconds."""
    return divmod(time_ns, 1_000_000_000)


def by_rosbags(folder):
    """A bag that rosbags writes; the tip is a point."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    header = lambda time: types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*split(time)), "base")
    vector = types["geometry_msgs/msg/Vector3"]
    point = types["geometry_msgs/msg/Point"]
    sent = []
    for time, force in forces():
        wrench = types["geometry_msgs/msg/Wrench"](vector(0.1, force, -2.0), vector(0.0, 0.0, 0.0))
        sent.append((time, "/ft", types["geometry_msgs/msg/WrenchStamped"](header(time), wrench)))
    for time, position in positions():
        numbers = [numpy.array(values) for values in ([0.7, position], [0.0, 0.0], [])]
        sent.append((time, "/joint_states", types["sensor_msgs/msg/JointState"](header(time), ["turn", "guide"], *numbers)))
    for time, tip in tips():
        sent.append((time, "/tip", types["geometry_msgs/msg/PointStamped"](header(time), point(0.0, tip, 0.03))))
    bag = folder / "rosbags"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {}
        for time, topic, message in sorted(sent, key=lambda one: one[0]):
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], time, store.serialize_cdr(message, kind))
    next(bag.glob("*.mcap")).rename(folder / "rosbags.mcap")


def by_mcap(folder, compression):
    """A bag that mcap-ros2-support writes; the tip is a pose, and a camera looks on."""
    with (folder / f"mcap-{compression.name.lower()}.mcap").open("wb") as stream:
        writer = RosWriter(stream, compression=compression)
        wrench = writer.register_msgdef(
            "geometry_msgs/msg/WrenchStamped",
            "std_msgs/Header header\ngeometry_msgs/Wrench wrench" + HEADER
            + "=" * 80 + "\nMSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque" + VECTOR,
        )
        joints = writer.register_msgdef(
            "sensor_msgs/msg/JointState",
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort" + HEADER,
        )
        pose = writer.register_msgdef(
            "geometry_msgs/msg/PoseStamped", "std_msgs/Header header\ngeometry_msgs/Pose pose" + HEADER + POSE
        )

        image = writer.register_msgdef(
            "sensor_msgs/msg/Image",
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data" + HEADER,
        )

        def send(topic, schema, time, message):
            seconds, nanoseconds = split(time)
            header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "base"}
            writer.write_message(topic, schema, {"header": header, **message}, log_time=time, publish_time=time)

        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        for time, force in forces():
            send("/ft", wrench, time, {"wrench": {"force": {"x": 0.1, "y": force, "z": -2.0}, "torque": zero}})
        for time, position in positions():
            send("/joint_states", joints, time,
                 {"name": ["turn", "guide"], "position": [0.7, position], "velocity": [0.0, 0.0], "effort": []})
        for time, tip in tips():
            send("/tip", pose, time, {"pose": {"position": {"x": 0.0, "y": tip, "z": 0.03},
                                               "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}})
            send("/camera/image_raw", image, time,
                 {"height": 2, "width": 3, "encoding": "mono8", "is_bigendian": 0, "step": 3, "data": bytes(range(6))})
        writer.finish()


def by_scipy(folder):
    """The push on the times of the forces, as files of MATLAB."""
    times = [time for time, _ in forces()]
    arrays = {
        "t": 1e-9 * (numpy.array(times) - START_NS),
        "x": numpy.array([pushed_m(time) for time in times]),
        "f": numpy.array([force for _, force in forces()]),
        "note": "simulated",
    }
    scipy.io.savemat(folder / "plain.mat", arrays)
    scipy.io.savemat(folder / "packed.mat", arrays, do_compression=True, oned_as="column")


made = pathlib.Path(sys.argv[1])
by_rosbags(made)
for compression in CompressionType:
    by_mcap(made, compression)
by_scipy(made)
