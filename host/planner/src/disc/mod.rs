//! Catching a flying disc with a four-axis arm (paper 001).
