#version 430
// Adds one layer of a level's light to the pixels that it belongs to.
layout(local_size_x = 8, local_size_y = 8) in;
#include "interleaved.glsl"

uniform sampler2D shuffled_light;
uniform int layer;
layout(rgba32f, binding = 0) uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec4 more = texelFetch(shuffled_light, to_shuffled(pixel, count_blocks(size)), 0);
    ivec3 at = ivec3(pixel, layer);
    imageStore(light, at, imageLoad(light, at) + more);
}
