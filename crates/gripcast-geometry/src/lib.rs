//! Geometry: rigid transforms, triangle meshes and mesh files, mass properties, stable poses,
//! bounding volumes.
//!
//! Lengths are metres, coordinates `f64`; `t_a_b` maps coordinates of frame b into frame a.
//!
//! ```
//! use gripcast_geometry::{MassProperties, PrepareOptions, builtin, prepare};
//!
//! // `load_mesh` reads a mesh file instead.
//! let mesh = prepare(&builtin("box")?, &PrepareOptions::default())?.mesh;
//! let volume_m3 = MassProperties::from_mesh(&mesh)?.volume_m3;
//! assert!((volume_m3 - 0.04 * 0.04 * 0.06).abs() < 1e-9);
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

mod aabb;
mod builtin;
mod bvh;
mod check;
mod convex_hull;
mod corner_normals;
mod curved;
mod grasp_geometry;
mod mass_properties;
mod mesh;
mod mesh_file;
mod mesh_query;
mod object_mesh;
mod pose;
mod ray_integral;
mod solid;
mod stable_poses;
mod weld;
mod winding_number;
mod wrist_camera;

pub use aabb::Aabb;
pub use builtin::implicit;
pub use builtin::{BUILTIN_NAMES, builtin};
pub use bvh::Bvh;
pub use check::{PrepareOptions, PreparedMesh, Repair, prepare};
pub use convex_hull::convex_hull;
pub use corner_normals::{CREASE_RAD, corner_normals};
pub use curved::curved;
pub use grasp_geometry::GraspGeometry;
pub use mass_properties::{MassProperties, check_mass};
pub use mesh::{MeshEdges, TriangleMesh};
pub use mesh_file::{
    ImageSource, LengthUnit, MeshFormat, MeshMaterial, MeshPart, TexturedMesh, load_mesh,
    load_textured_mesh, ply_bytes, read_mesh, read_textured_mesh, save_mesh,
};
pub use mesh_query::{ClosestPoint, MeshQuery, RayHit};
pub use object_mesh::{MeshOptions, load_object_mesh, load_object_mesh_below};
pub use pose::Pose;
pub use solid::Solid;
pub use stable_poses::{StablePose, likely_poses, nearest_pose, stable_poses};
pub use wrist_camera::WristCamera;
