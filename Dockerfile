# Builds the package in a workspace on ROS 2 Jazzy and runs its tests: docker build . (not tried on a build farm).
FROM ros:jazzy-ros-base
RUN apt-get update && apt-get install -y --no-install-recommends python3-pip && rm -rf /var/lib/apt/lists/*
WORKDIR /workspace
COPY . src/visual_compass
ENV PIP_BREAK_SYSTEM_PACKAGES=1
RUN apt-get update && rosdep update && rosdep install -y --from-paths src --ignore-src && rm -rf /var/lib/apt/lists/*
RUN . /opt/ros/jazzy/setup.sh && colcon build
RUN . install/setup.sh && colcon test && colcon test-result --verbose
CMD ["bash", "-c", ". install/setup.bash && ros2 launch visual_compass visual_compass.launch.py"]
