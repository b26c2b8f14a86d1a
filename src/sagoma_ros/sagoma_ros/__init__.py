"""ROS glue shared by all sagoma nodes: QoS, message conversion, parameters, diagnostics, lifecycle main."""
