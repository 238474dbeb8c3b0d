#version 430
void main() {} // depth only
