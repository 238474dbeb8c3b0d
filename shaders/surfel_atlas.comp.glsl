#version 430
// A phosphor's radiance beside where its atlas is covered, so that means over many texels can leave the gaps out. The
// copy is larger than the atlas by some texels that are not covered.
layout(local_size_x = 8, local_size_y = 8) in;

uniform sampler2DArray radiance;
uniform sampler2D position_w; // w: 1 where covered
layout(rgba32f, binding = 0) writeonly uniform image2DArray covered; // LAYERS, and one more with the cover

void main() {
    ivec2 texel = ivec2(gl_GlobalInvocationID.xy);
    if (any(greaterThanEqual(texel, imageSize(covered).xy))) return;
    bool there = all(lessThan(texel, textureSize(position_w, 0))) && texelFetch(position_w, texel, 0).w > 0.0;
    for (int l = 0; l < LAYERS; ++l)
        imageStore(covered, ivec3(texel, l), there ? texelFetch(radiance, ivec3(texel, l), 0) : vec4(0.0));
    imageStore(covered, ivec3(texel, LAYERS), vec4(there ? 1.0 : 0.0));
}
