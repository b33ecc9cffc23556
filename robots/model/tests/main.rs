//! The tests of this package as one program: it is linked once.

mod canopen6;
mod collision;
mod dynamics;
mod golden;
mod ik_numeric;
mod inverse_kinematics;
mod jacobian;
mod kr16_2;
mod odrive6;
mod openarm7;
mod padded;
mod pincher4;
mod powercube6_vectors;
mod refused_files;
mod survey;
mod urdf;
