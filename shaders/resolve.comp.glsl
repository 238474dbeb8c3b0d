#version 430
// The mean of a pixel's samples, band by band.
layout(local_size_x = 8, local_size_y = 8) in;
uniform sampler2DArray radiance;
layout(rgba32f, binding = 0) writeonly uniform image2DArray pixels;

void main() {
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(at, imageSize(pixels).xy))) return;
    for (int l = 0; l < LAYERS; ++l) {
        vec4 sum = vec4(0.0);
        for (int y = 0; y < SUPERSAMPLING; ++y)
            for (int x = 0; x < SUPERSAMPLING; ++x)
                sum += texelFetch(radiance, ivec3(at * SUPERSAMPLING + ivec2(x, y), l), 0);
        imageStore(pixels, ivec3(at, l), sum / float(SUPERSAMPLING * SUPERSAMPLING));
    }
}
