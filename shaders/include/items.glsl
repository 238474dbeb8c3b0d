// The number of this invocation: rows of more groups than a device takes are broken into several.
uint item_number() {
    return gl_GlobalInvocationID.y * (gl_NumWorkGroups.x * gl_WorkGroupSize.x) + gl_GlobalInvocationID.x;
}
