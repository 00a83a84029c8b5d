"""Layout of MAVLink frames, https://mavlink.io/en/guide/serialization.html."""

MAVLINK1_MAGIC = 0xFE
MAVLINK2_MAGIC = 0xFD
MAX_BYTES = 280
MAVLINK1_OVERHEAD_BYTES = 8
"""Header and checksum."""
MAVLINK2_OVERHEAD_BYTES = 12
"""Header and checksum."""
SIGNED_FLAG = 0x01
SIGNATURE_BLOCK_BYTES = 13
"""Link id, timestamp and signature."""
