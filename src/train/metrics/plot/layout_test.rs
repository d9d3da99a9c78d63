//! What holds for every figure: well-formed, inside its size, no text on another.
