#version 430
// Shares light among the pixels of a surface, along one axis: a box of 2 RADIUS pixels whose ends count half, so that
// every place of the pattern of directions counts alike. Cross-bilateral: by position and normal.
layout(local_size_x = 8, local_size_y = 8) in;
#include "receivers.glsl"
#include "alike.glsl"

uniform sampler2DArray light_in;
uniform ivec2 along;
layout(rgba16f, binding = 0) writeonly uniform image2DArray light;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), size = imageSize(light).xy;
    if (any(greaterThanEqual(pixel, size))) return;
    vec3 p, n, q, m;
    bool there = find_receiver(pixel, p, n);
    vec4 sum[LAYERS];
    float total = 0.0;
    for (int l = 0; l < LAYERS; ++l) sum[l] = vec4(0.0);
    for (int k = -RADIUS; there && k <= RADIUS; ++k) {
        ivec2 at = pixel + k * along;
        if (any(lessThan(at, ivec2(0))) || any(greaterThanEqual(at, size)) || !find_receiver(at, q, m)) continue;
        float w = (abs(k) == RADIUS ? 0.5 : 1.0) * (k == 0 ? 1.0 : alike(p, n, q, m));
        if (w <= 0.0) continue;
        total += w;
        for (int l = 0; l < LAYERS; ++l) sum[l] += w * texelFetch(light_in, ivec3(at, l), 0);
    }
    for (int l = 0; l < LAYERS; ++l) imageStore(light, ivec3(pixel, l), sum[l] / max(total, 1e-6));
}
