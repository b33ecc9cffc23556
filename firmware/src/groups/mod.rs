//! Groups of drives: each module speaks one family's protocol behind the controller.

pub mod powercube;
