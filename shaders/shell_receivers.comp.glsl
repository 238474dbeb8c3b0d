#version 430
// What the pixels see, shuffled into the sub-buffers of one level, so that splats read what lies side by side.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "interleaved.glsl"

layout(rgba32f, binding = 0) writeonly uniform image2D shuffled_position; // w: whether there is something
layout(rgba16f, binding = 1) writeonly uniform image2D shuffled_normal;

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy), size = picture_size(), blocks = count_blocks(size);
    if (any(greaterThanEqual(at, blocks << level))) return;
    ivec2 pixel = to_pixel(at, blocks);
    vec3 p = vec3(0.0), n = vec3(0.0);
    bool there = all(lessThan(pixel, size)) && find_receiver(pixel, p, n);
    imageStore(shuffled_position, at, vec4(p, there ? 1.0 : 0.0));
    imageStore(shuffled_normal, at, vec4(n, 0.0));
}
