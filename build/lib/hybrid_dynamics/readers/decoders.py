"""The libraries that read ROS bags and MCAP, which come with the extra ``bags``; imported when a bag is read."""

from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory as Ros1Decoder
from mcap_ros2.decoder import DecoderFactory as Ros2Decoder
from rosbags.rosbag1 import Reader as Bag1
from rosbags.rosbag2 import Reader as Bag2
from rosbags.typesys import Stores, get_typestore

__all__ = ["Bag1", "Bag2", "Ros1Decoder", "Ros2Decoder", "Stores", "get_typestore", "make_reader"]
