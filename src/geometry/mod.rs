//! Shapes and poses: rigid transforms, triangle meshes and their files, mass properties, stable
//! poses, bounding volumes.
