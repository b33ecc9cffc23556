//! Groups of drives behind the controller, against simulated drives that were written from the protocol alone. Virtual time.

mod arm;
mod cia402;
mod cia402_ip;
mod cia402_rig;
mod drawn;
mod fd;
mod find;
mod hands;
mod odrive;
mod odrive_rig;
mod rig;
mod six;
mod slow;
mod stops;
mod track;
