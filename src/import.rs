//! Data sets and phone captures to bags (L7).

pub mod mesh_file;
pub mod obj;
pub mod ply;
