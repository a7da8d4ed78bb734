"""Columns of the CSV files of sensors, in words: for the help of the command, and for errors."""

GYRO_COLUMNS = "t (s) or t_ns; yaw_rate (rad/s, left positive), or gx,gy,gz (rad/s) and ax,ay,az (m/s^2)"
ODOMETRY_COLUMNS = "t (s) or t_ns; yaw_rate (rad/s) or yaw (rad) or both, left positive; speed (m/s)"
TRUTH_COLUMNS = "t (s) or t_ns; yaw (rad, left positive)"
