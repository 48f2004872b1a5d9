"""Constants of the MCAP format that writer and reader share."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np

MAGIC: Final = b"\x89MCAP0\r\n"

HEADER: Final = 0x01
FOOTER: Final = 0x02
SCHEMA: Final = 0x03
CHANNEL: Final = 0x04
MESSAGE: Final = 0x05
CHUNK: Final = 0x06
MESSAGE_INDEX: Final = 0x07
CHUNK_INDEX: Final = 0x08
STATISTICS: Final = 0x0B
METADATA: Final = 0x0C
METADATA_INDEX: Final = 0x0D
SUMMARY_OFFSET: Final = 0x0E
DATA_END: Final = 0x0F

#: Head of every record: opcode and length of the contents.
RECORD_HEAD: Final = struct.Struct("<BQ")
#: Head of a message: head of the record, channel, sequence, log time and publish time [ns].
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
#: The same as a numpy dtype.
MESSAGE_HEAD_DTYPE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
#: Length of a message record beyond that of its data.
MESSAGE_OVERHEAD: Final = MESSAGE_HEAD.size - RECORD_HEAD.size
#: The end of a file: footer record (head, start of summary, start of summary offsets, checksum) and magic.
FOOTER_FORM: Final = struct.Struct("<BQQQI8s")
