// The hierarchical interleaved framebuffer (Nalbach 2017, 4.2.2): on level l a picture is 2^l x 2^l small pictures, its
// sub-buffers, and each block of 2^l x 2^l pixels gives one pixel to each of them, at random.
//
// Which pixel is told by an exclusive or with bits that are random for each block and level: it is its own inverse, and
// needs no table. One sub-buffer's pixels are as uniform and independent as under a random permutation.
#include "hash.glsl"

uniform int level;
uniform uint seed;

// Blocks along the sides of a picture: the size of a sub-buffer.
ivec2 count_blocks(ivec2 size) {
    return (size + (1 << level) - 1) >> level;
}

ivec2 scrambled(ivec2 place, ivec2 block) {
    uvec2 bits = hash(uvec3(block, seed * 32u + uint(level))).xy;
    return place ^ (ivec2(bits >> 8u) & ((1 << level) - 1));
}

// The pixel that lies at `at` among the sub-buffers; it may lie beyond the picture's edge.
ivec2 to_pixel(ivec2 at, ivec2 blocks) {
    ivec2 block = at % blocks;
    return (block << level) + scrambled(at / blocks, block);
}

// Where a pixel lies among the sub-buffers.
ivec2 to_shuffled(ivec2 pixel, ivec2 blocks) {
    ivec2 block = pixel >> level;
    return scrambled(pixel & ((1 << level) - 1), block) * blocks + block;
}
