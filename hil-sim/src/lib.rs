//! Simulated cell (in work): six PowerCubes, an arm and a CAN bus behind the wire.
