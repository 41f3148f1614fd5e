//! What runs on the device.
#![no_std]
pub mod calibration;
pub mod integrate;
pub mod rest;
pub mod sensor;
pub mod so3;
