//! Textured meshes that were made elsewhere: OBJ with MTL, glTF (`.glb`, `.gltf`), PLY.
//!
//! Images that a file names are looked for beside it. What a format says of its axes holds: glTF is
//! y up and is turned to z up; OBJ and PLY say nothing and stay as they are. Texture coordinates
//! come out v down. A damaged file is refused; none makes the reader fail otherwise.

mod gltf_file;
mod obj_file;
mod ply_file;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::geom::{ColorImage, EncodedColor, ImageError};
use crate::mesh::{ModelError, TexturedModel};

use super::ply::PlyError;

/// Why a textured mesh was refused.
#[derive(Debug, thiserror::Error)]
pub enum ModelFileError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The ending is not one of a format that is read.
    #[error("{} is not a textured mesh: its name ends in none of .obj, .glb, .gltf, .ply", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
    /// The file is damaged, or uses what is not read.
    #[error("{} is refused: {reason}", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The PLY file is damaged.
    #[error("{} is refused: {source}", path.display())]
    Ply {
        /// The file.
        path: PathBuf,
        /// Why.
        source: PlyError,
    },
    /// A texture does not decode.
    #[error("the texture {name} of {} is refused: {source}", path.display())]
    Texture {
        /// The mesh file.
        path: PathBuf,
        /// The texture, as the mesh names it.
        name: String,
        /// Why.
        source: ImageError,
    },
    /// The parts do not make a model.
    #[error("{} is refused: {source}", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// Why.
        source: ModelError,
    },
}

/// Reads a textured mesh; the ending of its name says the format.
///
/// # Errors
/// [`ModelFileError`] when the file or a texture that it names cannot be read or is damaged.
pub fn read(path: &Path) -> Result<TexturedModel, ModelFileError> {
    let ending = path.extension().map(|e| e.to_ascii_lowercase());
    let file = ModelFile { path };
    let parts = match ending.as_deref().and_then(|e| e.to_str()) {
        Some("obj") => obj_file::read(&file)?,
        Some("glb" | "gltf") => gltf_file::read(&file)?,
        Some("ply") => ply_file::read(&file)?,
        _ => {
            return Err(ModelFileError::Format {
                path: path.to_owned(),
            });
        }
    };
    TexturedModel::new(parts).map_err(|source| ModelFileError::Model {
        path: path.to_owned(),
        source,
    })
}

/// The mesh's file, for reading it and what lies beside it.
struct ModelFile<'a> {
    path: &'a Path,
}

impl ModelFile<'_> {
    fn bytes(&self) -> Result<Vec<u8>, ModelFileError> {
        read_bytes(self.path)
    }

    /// A file that the mesh names, relative to its own folder.
    fn beside(&self, name: &str) -> Result<Vec<u8>, ModelFileError> {
        // Files made on Windows name their textures with its separators.
        let name = name.replace('\\', "/");
        read_bytes(&self.path.parent().unwrap_or(Path::new("")).join(name))
    }

    fn image_beside(&self, name: &str) -> Result<Arc<ColorImage>, ModelFileError> {
        self.image(name, self.beside(name)?)
    }

    fn image(&self, name: &str, bytes: Vec<u8>) -> Result<Arc<ColorImage>, ModelFileError> {
        EncodedColor::from_file(bytes.into())
            .and_then(|encoded| encoded.decode())
            .map(Arc::new)
            .map_err(|source| ModelFileError::Texture {
                path: self.path.to_owned(),
                name: name.to_owned(),
                source,
            })
    }

    fn refuse(&self, reason: impl Into<String>) -> ModelFileError {
        ModelFileError::Refused {
            path: self.path.to_owned(),
            reason: reason.into(),
        }
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, ModelFileError> {
    std::fs::read(path).map_err(|source| ModelFileError::Read {
        path: path.to_owned(),
        source,
    })
}
