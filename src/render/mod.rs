//! Shading, sampling, film; tiles to image; progress, cancel, partial image.
