"""Real rclpy, with this package's messages built by rosidl, reads messages that veneer wrote, compares
them field by field with what they should say, and writes them again.

usage: interfaces_peer.py FOLDER      with N.cdr and N.json; writes N.theirs
"""

import array
import importlib
import json
import sys
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

folder = Path(sys.argv[1])


def class_of(name):
    package, kind, leaf = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    for part in ("_Request", "_Response"):
        if leaf.endswith(part):
            return getattr(getattr(module, leaf[: -len(part)]), part[1:])
    return getattr(module, leaf)


def plain(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, (list, tuple, array.array, np.ndarray)):
        return [plain(element) for element in value]
    if isinstance(value, np.generic):
        return value.item()
    return value


num_messages = 0
for path in sorted(folder.glob("*.cdr")):
    expected = json.loads(path.with_suffix(".json").read_text())
    message = deserialize_message(path.read_bytes(), class_of(expected["type"]))
    said = plain(message)
    assert list(said) == list(expected["says"]) or set(said) == set(expected["says"]), path
    assert said == expected["says"], f"{expected['type']}\n{said}\n{expected['says']}"
    path.with_suffix(".theirs").write_bytes(serialize_message(message))
    num_messages += 1
print(f"{num_messages} messages")
