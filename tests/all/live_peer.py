"""Real ROS 2 peers (rclpy) for the live node's tests. Each command prints one JSON object a line.

correct BAG      publishes the bag's poses as a path of corrections
watch            says what the diagnostics hold of memory
play BAG         publishes a bag's messages, byte for byte, at their pace; the mesh as shape_msgs/Mesh
camera           720p colour and depth at 30 Hz
listen TOPIC=TYPE …  receives until stdin closes, then says how many and how large
call SERVICE TYPE JSON  calls a service and prints its response
set NODE NAME=VALUE …  sets parameters
take TOPIC TYPE  prints messages
publish TOPIC TYPE HEX …  sends bytes, whatever they hold
graph NODE       what the graph shows of a node
"""

import argparse
import array
import json
import struct
import sys
import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.serialization import serialize_message

from played_bag import TOPICS, mesh_numbers, read_bag, say


def message_type(name):
    import importlib

    package, kind, last = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), last)


def qos(reliable, depth=10, latched=False):
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def shape_mesh(data):
    """mesh_msgs/MeshGeometryStamped as shape_msgs/Mesh: the same numbers."""
    from geometry_msgs.msg import Point
    from shape_msgs.msg import Mesh, MeshTriangle

    vertices, triangles = mesh_numbers(data)
    return Mesh(
        vertices=[Point(x=x, y=y, z=z) for x, y, z in vertices],
        triangles=[MeshTriangle(vertex_indices=array.array("I", three)) for three in triangles],
    )


def play(args):
    node = rclpy.create_node("player")
    messages = []
    publishers = {}
    for stamp, topic, type_name, data in read_bag(args.bag):
        if topic not in TOPICS:
            continue
        if type_name == "mesh_msgs/msg/MeshGeometryStamped":
            type_name, data = "shape_msgs/msg/Mesh", serialize_message(shape_mesh(data))
        topic = TOPICS[topic]
        if topic not in publishers:
            publishers[topic] = node.create_publisher(
                message_type(type_name), topic, qos(True, 100)
            )
        messages.append((stamp, topic, data))
    clock = None
    if args.clock:
        from rosgraph_msgs.msg import Clock

        clock = node.create_publisher(Clock, "/clock", qos(True, 100))
    deadline = time.monotonic() + args.wait
    wanted = set(publishers) - set(args.optional)
    while time.monotonic() < deadline:
        missing = [t for t in wanted if publishers[t].get_subscription_count() == 0]
        if not missing and (clock is None or clock.get_subscription_count() > 0):
            break
        rclpy.spin_once(node, timeout_sec=0.05)
    say(matched=not missing, missing=missing)
    time.sleep(0.5)
    sent = dict.fromkeys(publishers, 0)
    begun = time.monotonic()
    first = messages[args.start][0] if args.start < len(messages) else 0
    last_clock = None
    for at, (stamp, topic, data) in enumerate(messages):
        if at < args.start:
            continue
        due = begun + (stamp - first) * 1e-9 / args.rate
        while (left := due - time.monotonic()) > 0:
            time.sleep(min(left, 0.02))
        if clock is not None and stamp != last_clock:
            last_clock = stamp
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(stamp, 10**9)
            clock.publish(message)
            time.sleep(0.002)
        publishers[topic].publish(data)
        sent[topic] += 1
        if args.aloud:
            say(sent=sent, at=at + 1)
    say(sent=sent, seconds=time.monotonic() - begun)
    # Reliable messages may still have to be sent again.
    sys.stdin.read()
    node.destroy_node()


def camera(args):
    """A 720p colour and depth camera at its full rate, a pose for each frame, and a mesh."""
    from geometry_msgs.msg import Point, PoseStamped
    from sensor_msgs.msg import CameraInfo, CompressedImage, Image
    from shape_msgs.msg import Mesh, MeshTriangle

    import numpy

    node = rclpy.create_node("camera")
    width, height = 1280, 720
    rows, columns = numpy.mgrid[0:height, 0:width]
    picture = numpy.stack([columns % 256, rows % 256, (columns // 16 + rows // 16) % 2 * 255], -1)
    picture = picture.astype(numpy.uint8)
    color = Image(width=width, height=height, encoding="rgb8", step=3 * width)
    color.data = array.array("B", picture.tobytes())
    depth = Image(width=width, height=height, encoding="16UC1", step=2 * width)
    depth.data = array.array("B", numpy.full((height, width), 2000, "<u2").tobytes())
    color_type = depth_type = Image
    topics = ["/rgb/image", "/depth/image"]
    if args.jpeg:
        import io

        from PIL import Image as Pillow

        encoded = io.BytesIO()
        Pillow.fromarray(picture).save(encoded, "JPEG", quality=90)
        color = CompressedImage(format="jpeg", data=array.array("B", encoded.getvalue()))
        encoded = io.BytesIO()
        flat = Pillow.fromarray(numpy.full((height, width), 2000, numpy.uint16))
        flat.save(encoded, "PNG")
        header = struct.pack("<i2f", 0, 0.0, 0.0)
        depth = CompressedImage(
            format="16UC1; compressedDepth png",
            data=array.array("B", header + encoded.getvalue()),
        )
        color_type = depth_type = CompressedImage
        topics = ["/rgb/image/compressed", "/depth/image/compressedDepth"]
    info = CameraInfo(width=width, height=height, distortion_model="plumb_bob", d=[0.0] * 5)
    info.k = [900.0, 0.0, 639.5, 0.0, 900.0, 359.5, 0.0, 0.0, 1.0]
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    info.p = [900.0, 0.0, 639.5, 0.0, 0.0, 900.0, 359.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    of = lambda kind, topic, depth=10: node.create_publisher(
        kind, topic, qos(args.reliable, depth)
    )
    images = [of(color_type, topics[0]), of(depth_type, topics[1])]
    infos = [of(CameraInfo, "/rgb/camera_info"), of(CameraInfo, "/depth/camera_info")]
    poses = of(PoseStamped, "/pose")
    meshes = node.create_publisher(Mesh, "/mesh", qos(True, 1, latched=True))
    size = 20
    mesh = Mesh()
    for i in range(size + 1):
        for j in range(size + 1):
            mesh.vertices.append(Point(x=2.0 * i / size - 1, y=2.0 * j / size - 1, z=2.0))
    for i in range(size):
        for j in range(size):
            a = i * (size + 1) + j
            for triangle in [(a, a + 1, a + size + 1), (a + 1, a + size + 2, a + size + 1)]:
                mesh.triangles.append(MeshTriangle(vertex_indices=array.array("I", triangle)))
    meshes.publish(mesh)
    deadline = time.monotonic() + args.wait
    everyone = [*images, *infos, poses]
    while time.monotonic() < deadline and any(p.get_subscription_count() == 0 for p in everyone):
        rclpy.spin_once(node, timeout_sec=0.05)
    missing = [p.topic_name for p in everyone if p.get_subscription_count() == 0]
    say(matched=not missing, missing=missing)
    time.sleep(0.5)
    begun = time.monotonic()
    num = 0
    while time.monotonic() - begun < args.seconds:
        left = begun + num / args.rate - time.monotonic()
        if left > 0:
            time.sleep(left)
        now = node.get_clock().now()
        stamp = now.to_msg()
        pose = PoseStamped()
        pose.header.frame_id = "map"
        pose.header.stamp = stamp
        pose.pose.position.x = 0.2 * numpy.sin(0.5 * num / args.rate)
        pose.pose.orientation.w = 1.0
        poses.publish(pose)
        for message, publishers in [(color, images[:1]), (depth, images[1:]), (info, infos)]:
            message.header.frame_id = "camera"
            message.header.stamp = stamp
            for publisher in publishers:
                publisher.publish(message)
        num += 1
    say(sent=num, seconds=time.monotonic() - begun)
    sys.stdin.read()


def correct(args):
    """Publishes the poses of a bag as a path, shifted along x, as a loop closer does."""
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Path
    from rclpy.serialization import deserialize_message

    node = rclpy.create_node("closer")
    publisher = node.create_publisher(Path, "/pose_corrections", qos(True, 1, latched=True))
    path = Path()
    path.header.frame_id = "map"
    for _, topic, _, data in read_bag(args.bag):
        if topic == "/camera/pose":
            pose = deserialize_message(data, PoseStamped)
            pose.pose.position.x += args.shift
            path.poses.append(pose)
    deadline = time.monotonic() + args.wait
    while publisher.get_subscription_count() == 0 and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.05)
    say(matched=publisher.get_subscription_count() > 0)
    publisher.publish(path)
    say(poses=len(path.poses))
    sys.stdin.read()


def watch(args):
    """What the node says of its memory, each time it does, and when it said the first."""
    from diagnostic_msgs.msg import DiagnosticArray

    node = rclpy.create_node("watcher")
    begun = time.monotonic()

    def take(message):
        values = {}
        for status in message.status:
            part = status.name.split(": ")[1]
            values.update({f"{part} {pair.key}": pair.value for pair in status.values})
        number = lambda key: int(values.get(key, 0))
        say(
            wall=time.time(),
            seconds=time.monotonic() - begun,
            resident=number("process memory_bytes"),
            keyframes=number("keyframes bytes"),
            decoded=number("process decoded_image_bytes"),
            queued=number("process queue_bytes"),
        )

    node.create_subscription(DiagnosticArray, "/diagnostics", take, qos(True, 100))
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    say(watching=True)
    while not stop.is_set():
        rclpy.spin_once(node, timeout_sec=0.05)


def listen(args):
    node = rclpy.create_node("listener")
    begun = time.monotonic()
    counts = {}

    def note(topic):
        counts[topic] = {"num": 0, "max_bytes": 0, "bytes": 0, "first": None, "last": None}

        def take(data):
            entry = counts[topic]
            entry["num"] += 1
            entry["last"] = time.monotonic() - begun
            entry["first"] = entry["first"] or entry["last"]
            entry["max_bytes"] = max(entry["max_bytes"], len(data))
            entry["bytes"] += len(data)
            if args.dump:
                with open(f"{args.dump}/{topic.rsplit('/', 1)[-1]}", "ab") as file:
                    file.write(struct.pack("<I", len(data)) + data)

        return take

    for pair in args.topics:
        topic, type_name = pair.split("=")
        node.create_subscription(
            message_type(type_name), topic, note(topic), qos(True, 1000, args.latched), raw=True
        )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    say(listening=True)
    last = None
    while not stop.is_set():
        executor.spin_once(timeout_sec=0.05)
        now = json.dumps(counts)
        if now != last and args.chatty:
            last = now
            say(counts=counts)
    say(counts=counts)
    node.destroy_node()


def to_dict(message):
    if hasattr(message, "get_fields_and_field_types"):
        return {
            name: to_dict(getattr(message, name)) for name in message.get_fields_and_field_types()
        }
    if isinstance(message, (list, tuple, array.array)):
        return [to_dict(element) for element in message]
    if isinstance(message, bytes):
        return list(message)
    if hasattr(message, "tolist"):
        return message.tolist()
    return message


def fill(message, values):
    for name, value in values.items():
        current = getattr(message, name)
        if hasattr(current, "get_fields_and_field_types") and isinstance(value, dict):
            fill(current, value)
        else:
            setattr(message, name, value)
    return message


def call(args):
    node = rclpy.create_node("caller")
    service_type = message_type(args.type)
    client = node.create_client(service_type, args.service)
    if not client.wait_for_service(timeout_sec=args.wait):
        say(error="no such service")
        return
    begun = time.monotonic()
    future = client.call_async(fill(service_type.Request(), json.loads(args.request)))
    rclpy.spin_until_future_complete(node, future, timeout_sec=args.wait)
    if future.result() is None:
        say(error="no response")
        return
    say(response=to_dict(future.result()), seconds=time.monotonic() - begun)


def set_parameters(args):
    """Sets NAME=VALUE … one by one, in one request."""
    from rcl_interfaces.msg import Parameter
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter as Value

    node = rclpy.create_node("setter")
    client = node.create_client(SetParameters, f"{args.node}/set_parameters")
    if not client.wait_for_service(timeout_sec=args.wait):
        say(error="no such service")
        return
    request = SetParameters.Request()
    for pair in args.pairs:
        name, text = pair.split("=")
        try:
            value = json.loads(text)
        except ValueError:
            value = text
        request.parameters.append(
            Parameter(name=name, value=Value(name, value=value).get_parameter_value())
        )
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=args.wait)
    say(results=[to_dict(result) for result in future.result().results])


def take(args):
    """The next messages of a topic, as JSON."""
    node = rclpy.create_node("taker")
    taken = []
    node.create_subscription(
        message_type(args.type), args.topic, taken.append, qos(True, 100, args.latched)
    )
    deadline = time.monotonic() + args.wait
    while len(taken) < args.num and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.05)
    say(messages=[to_dict(message) for message in taken[: args.num]])


def publish(args):
    """Sends bytes as messages of a type, whatever they hold."""
    node = rclpy.create_node("publisher")
    publisher = node.create_publisher(message_type(args.type), args.topic, qos(True, 100))
    deadline = time.monotonic() + args.wait
    while publisher.get_subscription_count() == 0 and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.05)
    say(matched=publisher.get_subscription_count() > 0)
    for data in args.hex:
        publisher.publish(bytes.fromhex(data))
        time.sleep(0.05)
    say(sent=len(args.hex))
    sys.stdin.read()


def graph(args):
    """What the graph shows of a node."""
    node = rclpy.create_node("observer")
    deadline = time.monotonic() + args.wait
    name, namespace = args.name, args.namespace
    found = {}
    while time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.2)
        if (name, namespace) not in node.get_node_names_and_namespaces():
            continue
        pairs = node.get_subscriber_names_and_types_by_node(name, namespace)
        found = {
            "subscriptions": dict(pairs),
            "publishers": dict(node.get_publisher_names_and_types_by_node(name, namespace)),
            "services": dict(node.get_service_names_and_types_by_node(name, namespace)),
        }
        if all(topic in found["subscriptions"] for topic in args.subscriptions):
            break
    say(**found)


def main():
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("play")
    one.add_argument("bag")
    one.add_argument("--rate", type=float, default=1.0)
    one.add_argument("--clock", action="store_true")
    one.add_argument("--wait", type=float, default=15.0)
    one.add_argument("--optional", nargs="*", default=[])
    one.add_argument("--from", dest="start", type=int, default=0)
    one.add_argument("--aloud", action="store_true")
    one = commands.add_parser("correct")
    one.add_argument("bag")
    one.add_argument("--shift", type=float, default=0.0)
    one.add_argument("--wait", type=float, default=15.0)
    one = commands.add_parser("watch")
    one.add_argument("--wait", type=float, default=15.0)
    one = commands.add_parser("camera")
    one.add_argument("--rate", type=float, default=30.0)
    one.add_argument("--seconds", type=float, default=60.0)
    one.add_argument("--jpeg", action="store_true")
    one.add_argument("--reliable", action="store_true")
    one.add_argument("--wait", type=float, default=15.0)
    one = commands.add_parser("listen")
    one.add_argument("topics", nargs="+")
    one.add_argument("--latched", action="store_true")
    one.add_argument("--chatty", action="store_true")
    one.add_argument("--dump")
    one = commands.add_parser("call")
    one.add_argument("service")
    one.add_argument("type")
    one.add_argument("request", nargs="?", default="{}")
    one.add_argument("--wait", type=float, default=10.0)
    one = commands.add_parser("take")
    one.add_argument("topic")
    one.add_argument("type")
    one.add_argument("--num", type=int, default=1)
    one.add_argument("--wait", type=float, default=10.0)
    one.add_argument("--latched", action="store_true")
    one = commands.add_parser("publish")
    one.add_argument("topic")
    one.add_argument("type")
    one.add_argument("hex", nargs="+")
    one.add_argument("--wait", type=float, default=10.0)
    one = commands.add_parser("graph")
    one.add_argument("name")
    one.add_argument("--namespace", default="/")
    one.add_argument("--wait", type=float, default=10.0)
    one.add_argument("--subscriptions", nargs="*", default=[])
    one = commands.add_parser("set")
    one.add_argument("node")
    one.add_argument("pairs", nargs="+")
    one.add_argument("--wait", type=float, default=10.0)
    args = parser.parse_args()
    rclpy.init()
    {
        "play": play,
        "correct": correct,
        "watch": watch,
        "camera": camera,
        "listen": listen,
        "call": call,
        "take": take,
        "publish": publish,
        "graph": graph,
        "set": set_parameters,
    }[args.command](args)
    rclpy.try_shutdown()


main()
