#version 430
// Adds to every sample what was found for its pixel.
layout(local_size_x = 8, local_size_y = 8) in;

uniform sampler2DArray pixels;
layout(rgba32f, binding = 0) uniform image2DArray radiance;

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, imageSize(radiance).xy))) return;
    for (int l = 0; l < LAYERS; ++l) {
        ivec3 where = ivec3(at, l);
        vec4 more = texelFetch(pixels, ivec3(at / SUPERSAMPLING, l), 0);
        imageStore(radiance, where, imageLoad(radiance, where) + more);
    }
}
