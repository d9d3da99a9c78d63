//! The gels: tetrahedral grids with a log neo-Hookean law.
