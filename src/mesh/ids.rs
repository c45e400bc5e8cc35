//! Indices that cannot be mixed up.

/// Index of a vertex in its [`super::TriMesh`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VertexId(pub u32);

/// Index of a triangle in its [`super::TriMesh`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TriangleId(pub u32);

impl VertexId {
    /// For indexing a slice.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl TriangleId {
    /// For indexing a slice.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}
