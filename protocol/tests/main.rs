//! The tests of this package as one program: it is linked once.

mod canopen;
mod common;
mod cyphal_messages;
mod cyphal_node;
mod cyphal_receiver;
mod cyphal_transport;
mod mit;
mod odrive;
mod powercube_properties;
mod powercube_vectors;
