//! The object: an affine body (ABD, Lan et al. 2022) that stays very nearly rigid.
