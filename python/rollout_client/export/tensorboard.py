"""Events for TensorBoard: the success rate of each condition over time."""

from __future__ import annotations

import json
import os
from pathlib import Path

from ..archive import Archive
from . import import_package
from .rates import points


def export(archive: Archive, folder: str | os.PathLike[str]) -> int:
    """Writes a run into a TensorBoard folder and returns its number of points.

    Tags are `success_rate/LEVEL/CONDITION`; a point's step is the number of results of that
    condition so far, and its time is that of the latest commit. The text `specification` is the
    campaign's specification. Raises SettingsError if tensorboard is missing."""
    import_package("tensorboard")
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata
    from tensorboard.compat.proto.tensor_pb2 import TensorProto
    from tensorboard.compat.proto.types_pb2 import DT_STRING
    from tensorboard.summary.writer.event_file_writer import EventFileWriter

    writer = EventFileWriter(str(Path(folder) / archive.name))
    count, last = 0, 0.0
    try:
        for point in points(archive):
            value = Summary.Value(tag=f"success_rate/{point.condition}", simple_value=point.rate)
            summary, last = Summary(value=[value]), point.committed
            writer.add_event(Event(wall_time=last, step=point.results, summary=summary))
            count += 1
        text = "    " + json.dumps(archive.specification(), indent=2).replace("\n", "\n    ")
        metadata = SummaryMetadata(plugin_data=SummaryMetadata.PluginData(plugin_name="text"))
        tensor = TensorProto(dtype=DT_STRING, string_val=[text.encode()])
        value = Summary.Value(tag="specification", metadata=metadata, tensor=tensor)
        writer.add_event(Event(wall_time=last, step=0, summary=Summary(value=[value])))
    finally:
        writer.close()
    return count
