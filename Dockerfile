# docker build -t nsim .  &&  docker run --rm -v "$PWD:/work" nsim energy
FROM rust:1-bookworm AS build
WORKDIR /nsim
COPY . .
RUN cargo build --locked --profile dist --features pictures

FROM debian:bookworm-slim
COPY --from=build /nsim/target/dist/nsim /usr/local/bin/nsim
RUN mkdir -p /usr/local/share/man/man1 && nsim help --man /usr/local/share/man/man1
WORKDIR /work
ENTRYPOINT ["nsim"]
CMD ["--help"]
