# The bench of the @{label}: the same flags and the same bits on recorded flights.
@{variable}_FILES := @{name}.c @{stem}_bench.c
@{variable}_NEEDED := $(@{variable}_FILES) @{name}.h
@{variable}_RECORDING ?= @{recording}

.PHONY: @{target}-check @{target}-cpp @{target}-clang @{target}-arm64 @{target}-armhf @{target}-sanitized
.PHONY: @{target}-detected @{target}-cycles @{target}-stack @{target}-clean

check: @{target}-check
cpp: @{target}-cpp
clang: @{target}-clang
arm64: @{target}-arm64
armhf: @{target}-armhf
sanitized: @{target}-sanitized
@{detected}
cycles: @{target}-cycles
stack: @{target}-stack
clean: @{target}-clean

@{target}-check: @{target}-bench
	./@{target}-bench $(@{variable}_RECORDING)

@{target}-cpp: $(@{variable}_NEEDED)
	$(CXX) $(STRICTER) -x c++ -c @{name}.c -o @{target}-cpp.o
	$(CC) $(STRICT) @{stem}_bench.c @{target}-cpp.o -o @{target}-bench-cpp -lm
	./@{target}-bench-cpp $(@{variable}_RECORDING)

@{target}-clang: $(@{variable}_NEEDED)
	clang $(STRICT) $(@{variable}_FILES) -o @{target}-bench-clang -lm
	./@{target}-bench-clang $(@{variable}_RECORDING)

@{target}-arm64: $(@{variable}_NEEDED)
	aarch64-linux-gnu-gcc $(STRICT) $(@{variable}_FILES) -o @{target}-bench-arm64 -lm
	$(QEMU_ARM64) ./@{target}-bench-arm64 $(@{variable}_RECORDING)

@{target}-armhf: $(@{variable}_NEEDED)
	arm-linux-gnueabihf-gcc $(STRICT) $(@{variable}_FILES) -o @{target}-bench-armhf -lm
	$(QEMU_ARMHF) ./@{target}-bench-armhf $(@{variable}_RECORDING)

@{target}-sanitized: $(@{variable}_NEEDED)
	$(CC) $(STRICT) -g -fsanitize=address,undefined -fno-sanitize-recover=all $(@{variable}_FILES) -o @{target}-bench-sanitized -lm
	./@{target}-bench-sanitized $(@{variable}_RECORDING)
	./@{target}-bench-sanitized --hostile 200000 $(@{variable}_RECORDING)

@{target}-detected: $(@{variable}_NEEDED)
	$(CC) $(STRICT) -ffast-math -DDSSC_JAX_ANY_ARITHMETIC $(@{variable}_FILES) -o @{target}-bench-fast -lm
	! ./@{target}-bench-fast $(@{variable}_RECORDING)

@{target}-cycles: @{target}-bench
	./@{target}-bench --cycles $(@{variable}_RECORDING)

@{target}-stack: @{name}.c @{name}.h
	$(CC) $(STRICT) -fstack-usage -c @{name}.c -o @{target}-stack.o && cat @{target}-stack.su

@{target}-bench: $(@{variable}_NEEDED)
	$(CC) $(STRICT) $(@{variable}_FILES) -o $@@ -lm

@{target}-clean:
	rm -f @{target}-bench @{target}-bench-* @{target}-cpp.o @{target}-stack.o @{target}-stack.su
