// A surfel's splat into one level: the part of its sub-buffer that its shell may reach.
struct Splat {
    ivec4 rectangle; // first pixel and the one after the last, among the sub-buffers
    uint surfel;
};
