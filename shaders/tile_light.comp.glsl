#version 430
// The weighted mean of the radiance that a pixel's directions meet, in units of the frame's glow: E / π.
layout(local_size_x = 8, local_size_y = 8) in;

layout(std430, binding = 0) readonly buffer Hits { uvec2 hits[]; };      // DIRECTIONS a pixel: 1 + 2 cell + back, or 0; weight
layout(std430, binding = 1) readonly buffer Radiances { vec4 cells[]; }; // LAYERS a side, front and back of each
layout(rgba32f, binding = 0) writeonly uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec4 L[LAYERS];
    for (int l = 0; l < LAYERS; ++l) L[l] = vec4(0.0);
    int first = (pixel.y * size.x + pixel.x) * DIRECTIONS;
    for (int k = 0; k < DIRECTIONS; ++k) {
        uvec2 hit = hits[first + k];
        if (hit.x > 0u)
            for (int l = 0; l < LAYERS; ++l) L[l] += uintBitsToFloat(hit.y) * cells[(hit.x - 1u) * LAYERS + l];
    }
    for (int l = 0; l < LAYERS; ++l) imageStore(light, ivec3(pixel, l), L[l] / float(DIRECTIONS));
}
