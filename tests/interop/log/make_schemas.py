"""Writes the public schemas of the MCAP log, as a viewer finds them in the file, from the package of their publisher.

    make_schemas.py FILE        a FileDescriptorSet: each file after those it needs

The recorder includes FILE as it is; check_log.py compares what a recording carries with the package again.
"""

import sys

from foxglove_schemas_protobuf import FrameTransforms_pb2, JointStates_pb2, Log_pb2, SceneUpdate_pb2
from google.protobuf import descriptor_pb2


def descriptors():
    """The set as bytes."""
    wanted, seen = descriptor_pb2.FileDescriptorSet(), set()

    def add(file):
        if file.name not in seen:
            seen.add(file.name)
            for needed in file.dependencies:
                add(needed)
            file.CopyToProto(wanted.file.add())

    for module in (FrameTransforms_pb2, JointStates_pb2, Log_pb2, SceneUpdate_pb2):
        add(module.DESCRIPTOR)
    return wanted.SerializeToString(deterministic=True)


if __name__ == "__main__":
    with open(sys.argv[1], "wb") as out:
        out.write(descriptors())
