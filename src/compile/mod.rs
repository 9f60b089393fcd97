//! Triangles to a compiled file, in bounded memory: partition, cut, encode, write, seal.
