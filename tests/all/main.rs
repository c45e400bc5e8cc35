//! The one integration binary: each file is one subject.

mod export;
mod python;
mod report;
mod textured_room;
