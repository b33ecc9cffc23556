//! A hand that follows the flight parabola while the gripper opens (paper 000).
