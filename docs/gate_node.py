"""The gate as a ROS 2 node: lines come on a topic, verdicts go on another.

Start `pgti-gtsam gate --socket /tmp/gate.sock --radius 1 --state robots`, then `python3 gate_node.py`. Its parameters
are `socket` and `client`, the name that the gate keeps this robot's map by; without a name the map ends with the node.
A SLAM node publishes each g2o line, or JSON object, on `gate/lines` and reads a JSON object a line on `gate/verdicts`.
"""

import json
import socket
import threading

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import String

EVERY_LINE = QoSProfile(depth=1000)  # reliable by default: a line that is lost is a keyframe that is lost


class GateNode(Node):
    """Hands lines to a gate and publishes its answers."""

    def __init__(self):
        super().__init__("gate")
        path = self.declare_parameter("socket", "/tmp/gate.sock").value
        self._gate = socket.socket(socket.AF_UNIX)
        self._gate.connect(path)
        if name := self.declare_parameter("client", "").value:
            self._gate.sendall(json.dumps({"client": name}).encode() + b"\n")
        self._verdicts = self.create_publisher(String, "gate/verdicts", EVERY_LINE)
        self.create_subscription(String, "gate/lines", self._send, EVERY_LINE)
        threading.Thread(target=self._publish, daemon=True).start()

    def _send(self, message):
        self._gate.sendall(message.data.rstrip("\n").encode() + b"\n")

    def _publish(self):
        for line in self._gate.makefile(encoding="utf-8"):
            self._verdicts.publish(String(data=line.rstrip("\n")))


def main():
    """Run until the node is shut down."""
    rclpy.init()
    node = GateNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
